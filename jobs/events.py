"""One Redis stream a job: what happened, in order, to be read again from any point.

Types: state, stage, progress, densify, preview, warning, end. A `snapshot` is the record itself
(`JobRecords.snapshot`) and is not stored. An event id is its place in the stream.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import redis
import redis.asyncio

from jobs import keys
from jobs.errors import BadEventId

START = "0-0"  # before the first event
MAX_BLOCK_MS = 4000  # redis-py gives a silent socket up after 5 s
_ID = re.compile(r"\d{1,19}(-\d{1,19})?")


@dataclass(frozen=True)
class Event:
    """time: Unix seconds by the clock of Redis; data: JSON values, by type."""

    id: str
    type: str
    time: float
    data: dict[str, Any]


class Events:
    """Reading and writing, for the worker and for tests."""

    def __init__(self, connection: redis.Redis) -> None:
        self._redis: Any = connection  # typed for bytes; ours answers with text

    def publish(self, job_id: str, kind: str, data: Mapping[str, Any]) -> str:
        """Add an event outside of any change of the record. Its id."""
        seconds, microseconds = self._redis.time()
        fields = {
            "type": kind,
            "time": f"{seconds}.{microseconds:06d}",
            "data": json.dumps(data),
        }
        key = keys.events(job_id)
        added: str = self._redis.xadd(key, fields, maxlen=keys.EVENTS_KEPT, approximate=True)
        return added

    def read(
        self, job_id: str, after: str = START, block_ms: int = 0, count: int = 500
    ) -> list[Event]:
        """Events after the given id, oldest first. block_ms: wait so long for one, 0 not at all.

        Raises:
            BadEventId: `after` is not the id of an event.
        """
        streams = {keys.events(job_id): require_event_id(after)}
        answer = self._redis.xread(streams, count=count, block=_block(block_ms))
        return _by_stream(answer).get(keys.events(job_id), [])


class AsyncEvents:
    """Reading, for the API."""

    def __init__(self, connection: redis.asyncio.Redis) -> None:
        self._redis: Any = connection  # typed for bytes; ours answers with text

    async def read(
        self, job_id: str, after: str = START, block_ms: int = 0, count: int = 500
    ) -> list[Event]:
        """As `Events.read`."""
        found = await self.read_many({job_id: after}, block_ms, count)
        return found.get(job_id, [])

    async def read_many(
        self, after: Mapping[str, str], block_ms: int = 0, count: int = 500
    ) -> dict[str, list[Event]]:
        """New events of several jobs, by job id. after: the last id seen of each.

        Raises:
            BadEventId: one of the ids is not the id of an event.
        """
        names = {keys.events(job_id): job_id for job_id in after}
        streams = {key: require_event_id(after[job_id]) for key, job_id in names.items()}
        answer = await self._redis.xread(streams, count=count, block=_block(block_ms))
        return {names[key]: events for key, events in _by_stream(answer).items()}

    async def has_gap(self, job_id: str, after: str) -> bool:
        """Whether events after this id were dropped already, so that the reader needs a snapshot.

        Raises:
            BadEventId: `after` is not the id of an event.
        """
        wanted = _place(require_event_id(after))
        if wanted == (0, 0):
            return False
        first = await self._redis.xrange(keys.events(job_id), count=1)
        return not first or wanted < _place(first[0][0])


def require_event_id(text: str) -> str:
    """The text itself.

    Raises:
        BadEventId: it does not have the form of an event id.
    """
    if not _ID.fullmatch(text):
        raise BadEventId('an event id looks like "1732233600000-0"; use one from an earlier event')
    return text


def _place(event_id: str) -> tuple[int, int]:
    milliseconds, _, number = event_id.partition("-")
    return int(milliseconds), int(number or 0)


def _block(block_ms: int) -> int | None:
    return min(block_ms, MAX_BLOCK_MS) or None  # 0 would wait for ever


def _by_stream(answer: Any) -> dict[str, list[Event]]:
    """RESP3 answers with a mapping, RESP2 with pairs."""
    pairs = answer.items() if isinstance(answer, dict) else answer or []
    found: dict[str, list[Event]] = {}
    for key, entries in pairs:
        batches = entries if entries and isinstance(entries[0], list) else [entries]
        found[key] = [_event(*entry) for batch in batches for entry in batch]
    return found


def _event(event_id: str, fields: Mapping[str, str]) -> Event:
    return Event(event_id, fields["type"], float(fields["time"]), json.loads(fields["data"]))
