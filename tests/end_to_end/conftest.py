"""Everything for real: supervisor, Redis, worker, reaper and API, started once for all tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from api_process import ROOT, free_port, wait_until_up
from user_steps import KEY, Finished, sphere, submit, wait


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of the running service."""
    return tmp_path_factory.mktemp("up") / "data"


@pytest.fixture(scope="session")
def url(data_folder: Path) -> Iterator[str]:
    """The address of a running service."""
    with running(data_folder) as address:
        yield address


@pytest.fixture
def locked_url(tmp_path: Path) -> Iterator[str]:
    """The address of a service that wants KEY."""
    with running(tmp_path / "data", UDFLOW_KEY=KEY) as address:
        yield address


@contextmanager
def running(data: Path, **more: str) -> Iterator[str]:
    """`service.up`, ready. Ctrl-C must end all of it."""
    folder = data.parent
    port = free_port()
    environment = {
        **{name: value for name, value in os.environ.items() if name != "REDIS_URL"},
        "PORT": str(port),
        "UDFLOW_DATA": str(data),
        "OMP_NUM_THREADS": "1",
        **more,
    }
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.up"],
            cwd=ROOT,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    address = f"http://127.0.0.1:{port}"
    try:
        wait_until_up(address, process, "/readyz", 90)
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(20)
    assert code == 0, (folder / "log").read_text()


@pytest.fixture
def client(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=url, timeout=70) as http:
        yield http


@pytest.fixture(scope="session")
def finished(url: str) -> Finished:
    with httpx.Client(base_url=url, timeout=70) as client:
        points = sphere(1500)
        job_id = submit(client, points)
        job = wait(client, job_id)
    assert job["state"] == "succeeded", job
    return Finished(job_id, points, job)
