"""One API over a real Redis for all tests here; they play the worker themselves."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

import httpx
import pytest
import redis
from api_process import Api, ApiProcess, ball
from chaos_kit import in_background

from jobs.events import Events
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobSpec, JobState
from jobs.store import FileStore
from udflow.config import preset, to_dict


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
def events(redis_client: redis.Redis) -> Events:
    return Events(redis_client)


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
def at_work(started: str, records: JobRecords) -> AbstractContextManager[None]:
    """While it lasts, the running job goes from round to round; then it succeeds."""

    def work(over: threading.Event) -> None:
        step = 0
        while not over.is_set():
            step += 1
            # states, so that none may be left out for a slow reader
            records.update(started, 1, ("densify", {"round": step}), round=step)
            time.sleep(0.002)
        records.finish(started, 1, JobState.SUCCEEDED)

    return in_background(work)


@pytest.fixture
def scan(client: httpx.Client) -> dict[str, Any]:
    answer = client.post("/v1/scans", files={"file": ("ball.npy", ball())})
    assert answer.status_code in (200, 201), answer.text
    values: dict[str, Any] = answer.json()
    return values
