"""Fixtures that several parts share: a real Redis, never an imitation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import redis

from jobs.dispatch import Dispatcher
from jobs.events import Events
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.signing import load_secret
from jobs.store import FileStore


@pytest.fixture(scope="session")
def redis_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmbeddedRedis]:
    """One server for the whole run."""
    server = EmbeddedRedis(tmp_path_factory.mktemp("redis"))
    server.start()
    yield server
    server.stop()


@pytest.fixture
def settings(redis_server: EmbeddedRedis, tmp_path: Path) -> Settings:
    """An empty Redis (its database 0) and an empty data folder for each test."""
    found = Settings(data=tmp_path / "data", redis_url=redis_server.url)
    with found.connect() as client:
        client.flushdb()
    return found


@pytest.fixture
def connection(settings: Settings) -> Iterator[redis.Redis]:
    with settings.connect() as client:
        yield client


@pytest.fixture
def records(connection: redis.Redis) -> JobRecords:
    return JobRecords(connection)


@pytest.fixture
def events(connection: redis.Redis) -> Events:
    return Events(connection)


@pytest.fixture
def store(settings: Settings) -> FileStore:
    return FileStore(settings.data)


@pytest.fixture
def dispatcher(settings: Settings) -> Iterator[Dispatcher]:
    with settings.connect_raw() as client:
        yield Dispatcher(client, load_secret(settings), settings.job_timeout_s)


@pytest.fixture
def quick_settings(settings: Settings) -> Settings:
    """Short leases and graces, for tests that wait for them to pass."""
    return replace(settings, lease_s=1.5, cancel_grace_s=0.5, reaper_period_s=0.3)
