"""Looking at job records from an event loop: one round trip, no thread."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import redis.asyncio

from jobs import keys
from jobs.fields import record_of
from jobs.records import Idempotency, Snapshot


@dataclass(frozen=True)
class Look(Snapshot):
    """A snapshot with its place in the queue: 1 is next, None when it does not wait."""

    queue_position: int | None


class AsyncRecords:
    """As `JobRecords`, for those who only look. connection: with text answers.

    All methods raise redis.exceptions.RedisError when Redis does not answer.
    """

    def __init__(self, connection: redis.asyncio.Redis) -> None:
        self._redis: Any = connection  # typed for bytes; ours answers with text

    async def look(self, job_id: str) -> Look | None:
        """The record, its place among its events and in the queue, read at one moment."""
        async with self._redis.pipeline(transaction=True) as pipe:
            pipe.hgetall(keys.job(job_id))
            pipe.xrevrange(keys.events(job_id), count=1)
            pipe.zrank(keys.QUEUED, job_id)
            fields, last, rank = await pipe.execute()
        if "state" not in fields:
            return None
        position = None if rank is None else int(rank) + 1
        return Look(record_of(fields), last[0][0] if last else "0-0", position)

    async def made_by(self, request: Idempotency) -> str | None:
        """The id of the job that the same request made before."""
        name = hashlib.sha256(request.key.encode()).hexdigest()
        seen = await self._redis.get(keys.idempotency(name))
        digest, _, job_id = (seen or "").partition(" ")
        return job_id if digest == request.fingerprint else None

    async def is_gone(self, some_id: str) -> bool:
        """Whether a job or scan existed and was deleted or has expired."""
        return bool(await self._redis.exists(keys.tombstone(some_id)))
