# A worker: takes jobs from the queue and reconstructs. Build from the root of the repository:
#   docker build -f docker/worker.Dockerfile -t udflow-worker .
# Build arguments, explained in docs/operations.md:
#   PIP_INDEX_URL     where pip finds packages; pip's own default if not given
#   TORCH_INDEX_URL   where pip finds PyTorch alone
#   ACCELERATOR       cpu (default) or cuda: the build fails if the index served the other

FROM python:3.11.14-slim-bookworm AS packages
ARG PIP_INDEX_URL
ARG TORCH_INDEX_URL
ARG ACCELERATOR=cpu
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PATH=/opt/venv/bin:$PATH
WORKDIR /build
RUN python -m venv /opt/venv
COPY pyproject.toml constraints.txt docker/requirements.py docker/check_torch.py ./
# PyTorch first and alone: it is the largest layer by far and changes least.
RUN python requirements.py torch > torch.txt \
    && pip install --no-deps ${TORCH_INDEX_URL:+--index-url "$TORCH_INDEX_URL"} -r torch.txt
RUN python requirements.py all > all.txt \
    && pip install --constraint constraints.txt -r all.txt \
    && python check_torch.py "$ACCELERATOR"

FROM python:3.11.14-slim-bookworm
RUN useradd --uid 10001 --no-create-home --shell /usr/sbin/nologin udflow \
    && install -d -o 10001 -g 10001 -m 0700 /data /loops
ENV PATH=/opt/venv/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 UDFLOW_DATA=/data \
    NUMBA_CACHE_DIR=/loops
WORKDIR /app
COPY --from=packages /opt/venv /opt/venv
COPY docker/worker_health.py ./
COPY udflow udflow
COPY jobs jobs
COPY worker worker
# Kept for the processor that the image is built on; on another one the first start compiles anew.
RUN python -m udflow.compile_loops && chown -R 10001:10001 /loops
USER 10001
HEALTHCHECK --interval=15s --timeout=10s --start-period=60s --retries=3 \
    CMD ["python", "worker_health.py"]
CMD ["python", "-m", "worker"]
