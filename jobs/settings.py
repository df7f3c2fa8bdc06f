"""The environment that service and worker share, and the connections made from it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import redis
import redis.asyncio
from redis.asyncio import BlockingConnectionPool

from jobs.errors import BadSetting, NoRedisServer

_CONNECTIONS = 32  # of an event loop to Redis


@dataclass(frozen=True)
class Settings:
    """How the parts find each other.

    data: folder for scans, results, logs, secret and the embedded Redis.
    redis_url: None while no Redis is known; `make up` starts one and sets it.
    store_url: where scans and results are, file:///folder or s3://bucket/prefix; None means the
        data folder, which may then not be shared by other means than a common file system.
    secret: signs queued tasks; None means the key file in the data folder.
    lease_s: a worker that has not renewed for so long has lost its job.
    cancel_grace_s: a canceled job that has not stopped by itself is killed after this;
        partial_grace_s: the same when it is to keep a mesh of what is fitted so far.
    checkpoint_s: how often a field in training is saved, for another worker to go on with.
    stall_s: a fit without any progress for so long counts as hung.
    job_timeout_s: longest run of one attempt; queue_ttl_s: longest wait in the queue.
    upload_life_s: how long a resumable upload waits for its next bytes; scan_life_s: how long a
        scan is kept that no job uses any more.
    webhook_secret: signs webhooks; None means that there are none. webhook_hosts: names of hosts
        that may be called though they are not on the open internet, also without TLS.
    device: where to fit; None takes the GPU if there is one.
    """

    data: Path = Path(".udflow")
    redis_url: str | None = None
    store_url: str | None = None
    secret: str | None = None
    lease_s: float = 20.0
    cancel_grace_s: float = 8.0
    partial_grace_s: float = 180.0
    reaper_period_s: float = 5.0
    checkpoint_s: float = 10.0
    stall_s: float = 300.0
    job_timeout_s: float = 4 * 3600.0
    queue_ttl_s: float = 24 * 3600.0
    upload_life_s: float = 24 * 3600.0
    scan_life_s: float = 30 * 24 * 3600.0
    webhook_secret: str | None = None
    webhook_hosts: tuple[str, ...] = ()
    device: str | None = None

    @classmethod
    def from_env(cls, environ: Mapping[str, str] = os.environ) -> Settings:
        """Settings from REDIS_URL and the UDFLOW_ variables.

        Raises:
            BadSetting: a duration is not a positive number, or the device is of no known kind.
        """
        durations = {
            name: _positive(f"UDFLOW_{name.upper()}", environ)
            for name in (
                "lease_s",
                "cancel_grace_s",
                "partial_grace_s",
                "reaper_period_s",
                "checkpoint_s",
                "stall_s",
                "job_timeout_s",
                "queue_ttl_s",
                "upload_life_s",
                "scan_life_s",
            )
            if f"UDFLOW_{name.upper()}" in environ
        }
        return cls(
            data=Path(environ.get("UDFLOW_DATA") or ".udflow"),
            redis_url=environ.get("REDIS_URL") or None,
            store_url=environ.get("STORE_URL") or None,
            secret=environ.get("UDFLOW_SECRET") or None,
            webhook_secret=environ.get("UDFLOW_WEBHOOK_SECRET") or None,
            webhook_hosts=_names(environ.get("UDFLOW_WEBHOOK_HOSTS", "")),
            device=_device(environ.get("UDFLOW_DEVICE") or None),
            **durations,
        )

    @property
    def url(self) -> str:
        """The URL of Redis.

        Raises:
            NoRedisServer: it is not set.
        """
        if self.redis_url is None:
            raise NoRedisServer(
                "REDIS_URL is not set, so there is no Redis to talk to; start everything with "
                "`make up`, or set it, for example REDIS_URL=redis://127.0.0.1:6379"
            )
        return self.redis_url

    def connect(self, **options: Any) -> redis.Redis:
        """For records and events: answers are text. options: as for `redis.Redis`."""
        return redis.Redis.from_url(self.url, decode_responses=True, **options)

    def connect_async(self) -> redis.asyncio.Redis:
        """For the API's event loop: answers are text."""
        return self._shared_by_many(decode_responses=True)

    def connect_async_raw(self) -> redis.asyncio.Redis:
        """For the API's readers of preview frames: answers are bytes."""
        return self._shared_by_many()

    def _shared_by_many(self, **options: Any) -> redis.asyncio.Redis:
        """Hundreds may ask at once: they wait for one of a few connections. A connection for each
        would be more than the server's socket takes in one moment."""
        pool = BlockingConnectionPool.from_url(self.url, max_connections=_CONNECTIONS, **options)
        return redis.asyncio.Redis.from_pool(pool)

    def connect_raw(self) -> redis.Redis:
        """For RQ, which wants bytes."""
        return redis.Redis.from_url(self.url)


def _device(name: str | None) -> str | None:
    if name is not None and not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        raise BadSetting(f'UDFLOW_DEVICE is {name!r}; choose "cpu", "cuda" or "cuda:0"')
    return name


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip().lower() for name in text.split(",") if name.strip())


def _positive(name: str, environ: Mapping[str, str]) -> float:
    try:
        value = float(environ[name])
    except ValueError as error:
        raise BadSetting(f"{name} is {environ[name]!r}; give seconds, for example 20") from error
    if not 0.0 < value < 1e9:
        raise BadSetting(f"{name} is {environ[name]!r}; give a positive number of seconds")
    return value
