"""A workshop whose processes may be killed at named places, on a Redis of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from chaos_kit import Faults
from workshop import Workshop, settings_for

from jobs.redis_server import EmbeddedRedis


@dataclass
class Ground:
    """Where things are broken: a Redis that may be killed, a workshop on it, faults to arm."""

    server: EmbeddedRedis
    shop: Workshop
    faults: Faults

    def kill_redis(self, away_s: float = 0.0) -> None:
        """kill -9, and up again."""
        assert self.server._process is not None
        self.server._process.kill()
        self.server.stop()
        time.sleep(away_s)
        self.server.start()


def ground_in(folder: Path) -> Iterator[Ground]:
    """A fresh one, taken down at the end."""
    (folder / "faults").mkdir(parents=True)
    server = EmbeddedRedis(folder / "redis")
    server.start()
    shop = Workshop(settings_for(server, folder / "data", 0))
    yield Ground(server, shop, Faults(folder / "faults"))
    shop.close()
    server.stop()


@pytest.fixture
def ground(tmp_path: Path) -> Iterator[Ground]:
    yield from ground_in(tmp_path / "ground")


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    """One for all tests of a module."""
    yield from ground_in(tmp_path_factory.mktemp("ground") / "ground")
