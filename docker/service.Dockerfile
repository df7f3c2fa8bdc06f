# The API. Build from the root of the repository:
#   docker build -f docker/service.Dockerfile -t udflow-service .
# It needs PyTorch as well, to answer distance queries. The first stage is that of
# worker.Dockerfile word for word, so that both images share its layers; see there for the build
# arguments.

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

# The page. NPM_CONFIG_REGISTRY: where npm finds packages; its own default if not given.
FROM node:22.12.0-bookworm-slim AS page
ARG NPM_CONFIG_REGISTRY
WORKDIR /build
COPY web/package.json web/package-lock.json ./
RUN npm ci --ignore-scripts --no-audit --no-fund
COPY web ./
RUN npm run build

FROM python:3.11.14-slim-bookworm
RUN useradd --uid 10001 --no-create-home --shell /usr/sbin/nologin udflow \
    && install -d -o 10001 -g 10001 -m 0700 /data /loops
ENV PATH=/opt/venv/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 UDFLOW_DATA=/data \
    NUMBA_CACHE_DIR=/loops
# Inside a container loopback reaches nobody, so it listens everywhere, and so it wants UDFLOW_KEY.
ENV UDFLOW_HOST=0.0.0.0 PORT=8000
WORKDIR /app
COPY --from=packages /opt/venv /opt/venv
COPY docker/service_health.py ./
COPY udflow udflow
COPY jobs jobs
COPY service service
COPY --from=page /build/dist web/dist
# Kept for the processor that the image is built on; on another one the first start compiles anew.
RUN python -m udflow.compile_loops && chown -R 10001:10001 /loops
USER 10001
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "service_health.py"]
CMD ["python", "-m", "service.serve"]
