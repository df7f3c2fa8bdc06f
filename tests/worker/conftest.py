"""Workshops of this folder's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from workshop import Workshop, settings_for

from jobs.redis_server import EmbeddedRedis


@pytest.fixture(scope="session")
def standing_shop(
    redis_server: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workshop]:
    """One worker for all tests."""
    workshop = Workshop(settings_for(redis_server, tmp_path_factory.mktemp("shop") / "data", 1))
    workshop.start_worker()
    yield workshop
    workshop.close()


@pytest.fixture
def shop(standing_shop: Workshop) -> Iterator[Workshop]:
    """The shared one; what a test leaves behind does not keep the next one waiting."""
    yield standing_shop
    for record in standing_shop.records.queued() + standing_shop.records.active():
        standing_shop.records.request_cancel(record.id)


@pytest.fixture
def own_shop(redis_server: EmbeddedRedis, tmp_path: Path) -> Iterator[Workshop]:
    """No worker yet, and nothing in its Redis."""
    settings = settings_for(redis_server, tmp_path / "data", 2)
    with settings.connect() as client:
        client.flushdb()
    workshop = Workshop(settings)
    yield workshop
    workshop.close()
