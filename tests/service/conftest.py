"""The API as a process of its own over a real Redis; the tests play the worker themselves."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import redis

from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobSpec
from jobs.store import FileStore
from udflow.config import preset, to_dict

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Api:
    """A running API process. url: "http://127.0.0.1:port"; log: what it has written."""

    url: str
    shared: Settings
    log: Path

    @property
    def ws(self) -> str:
        return self.url.replace("http:", "ws:")


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


@dataclass
class ApiProcess:
    """Starts and stops `python -m service`."""

    shared: Settings
    log: Path
    environment: dict[str, str]

    def __enter__(self) -> Api:
        port = free_port()
        environment = {
            **os.environ,
            "PORT": str(port),
            "REDIS_URL": self.shared.url,
            "UDFLOW_DATA": str(self.shared.data),
            "OMP_NUM_THREADS": "1",
            **self.environment,
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "service"],
            cwd=ROOT,
            env=environment,
            stderr=self.log.open("wb"),
        )
        api = Api(f"http://127.0.0.1:{port}", self.shared, self.log)
        wait_until_up(api.url, self._process)
        return api

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(15)


def wait_until_up(url: str, process: subprocess.Popen[bytes], seconds: float = 30) -> None:
    deadline = time.monotonic() + seconds
    while True:
        assert process.poll() is None, "the process ended before it answered"
        assert time.monotonic() < deadline, "the API does not answer"
        try:
            httpx.get(f"{url}/healthz")
            return
        except httpx.TransportError:
            time.sleep(0.05)


@pytest.fixture(scope="session")
def api_redis(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmbeddedRedis]:
    """Not the one that other tests flush."""
    server = EmbeddedRedis(tmp_path_factory.mktemp("api-redis"))
    server.start()
    yield server
    server.stop()


@pytest.fixture(scope="session")
def api(api_redis: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder = tmp_path_factory.mktemp("api")
    shared = Settings(data=folder / "data", redis_url=api_redis.url)
    limits = {"UDFLOW_MAX_UPLOAD_MB": "4", "UDFLOW_BODY_TIMEOUT_S": "1"}
    with ApiProcess(shared, folder / "log", limits) as running:
        yield running


@pytest.fixture
def client(api: Api) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=api.url, timeout=30) as http:
        yield http


@pytest.fixture
def redis_client(api: Api) -> Iterator[redis.Redis]:
    with api.shared.connect() as connection:
        yield connection


@pytest.fixture
def records(redis_client: redis.Redis) -> JobRecords:
    return JobRecords(redis_client)


@pytest.fixture
def store(api: Api) -> FileStore:
    return FileStore(api.shared.data)


@pytest.fixture
def queued(records: JobRecords, store: FileStore, scan: dict[str, Any]) -> str:
    """The id of a waiting job that no worker will take."""
    spec = JobSpec.new(scan["id"], to_dict(preset("fast")))
    records.create(spec)
    return spec.id


@pytest.fixture
def started(queued: str, records: JobRecords) -> str:
    """The id of a running job; the test is its worker."""
    assert records.claim(queued, 1, "test", "cpu") is not None
    return queued


@pytest.fixture
def scan(client: httpx.Client) -> dict[str, Any]:
    answer = client.post("/v1/scans", files={"file": ("ball.npy", ball())})
    assert answer.status_code in (200, 201), answer.text
    values: dict[str, Any] = answer.json()
    return values


def ball(points: int = 500) -> bytes:
    """A sphere of radius 1 as .npy."""
    normal = np.random.default_rng(0).normal(size=(points, 3))
    return npy(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()
