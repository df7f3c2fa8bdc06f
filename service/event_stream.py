"""What a client of a job's events is told, whatever the transport."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, AsyncIterator
from dataclasses import dataclass
from typing import Any

from jobs.async_records import AsyncRecords, Look
from jobs.events import START, AsyncEvents, Event, require_event_id
from jobs.records import Snapshot
from service.callers import current
from service.event_hub import EventHub
from service.event_message import Message
from service.job_view import job_view

HEARTBEAT_S = 15.0
PAGE = 500


class UnknownJob(Exception):
    """There is no such job, or it was deleted while it was watched."""


@dataclass(frozen=True)
class EventSource:
    """Where events come from.

    heartbeat_s: longest silence towards a client.
    """

    records: AsyncRecords
    events: AsyncEvents
    hub: EventHub
    heartbeat_s: float = HEARTBEAT_S

    async def stream(self, job_id: str, after: str | None) -> AsyncGenerator[Message]:
        """A snapshot, then events until the end of the job.

        With `after`, everything since that event follows the snapshot, without loss or repeat; if
        part of it is no longer kept, a `gap` says so and the events go on from the snapshot.
        A message without id is a heartbeat.

        Raises:
            UnknownJob: there is no such job (any more).
            BadEventId: `after` is not an event id.
            Overflow: the client is too slow.
        """
        if after is not None:
            require_event_id(after)
        snapshot = await self._snapshot(job_id)
        start = snapshot.last_event
        with self.hub.watch(job_id, snapshot.last_event) as watcher:
            if after is not None and await self._has_gap(job_id, after, snapshot):
                data = {"after": after, "resumed_at": start}
                yield Message(start, "gap", time.time(), data)
            elif after is not None:
                start = after
            shown = job_view(snapshot.record, snapshot.queue_position)
            yield Message(start, "snapshot", time.time(), shown.model_dump(mode="json"))
            if after is None and snapshot.record.is_terminal:
                yield _end(snapshot)
                return
            until = max(watcher.since, snapshot.last_event, key=place)
            async for event in self._replay(job_id, start, until):
                yield Message.of(event)
                start = event.id
                if event.type == "end":
                    return
            if snapshot.record.is_terminal:
                return  # the client had seen the end before
            while True:
                live = await watcher.next(self.heartbeat_s)
                if live is None:
                    await self._snapshot(job_id)
                    yield Message(None, "heartbeat", time.time(), {})
                elif live.id is not None and place(live.id) > place(start):
                    yield live
                    if live.type == "end":
                        return

    async def page(self, job_id: str, after: str, limit: int) -> tuple[list[Event], bool]:
        """Up to `limit` events after an id, and whether no more will come."""
        snapshot = await self._snapshot(job_id)
        events = await self.events.read(job_id, after, count=limit)
        if events:
            return events, events[-1].type == "end"
        return [], snapshot.record.is_terminal

    async def wait_for_change(
        self, job_id: str, known: Snapshot, timeout_s: float, to_end: bool
    ) -> None:
        """Returns at the next event of the job (or at its end only), or after the timeout."""
        deadline = time.monotonic() + timeout_s
        with self.hub.watch(job_id, known.last_event) as watcher:
            now = await self.records.look(job_id)
            if now is None or now.record.is_terminal:
                return
            if now.last_event != known.last_event and not to_end:
                return
            while (left := deadline - time.monotonic()) > 0:
                event = await watcher.next(left)
                if event is not None and (event.type == "end" or not to_end):
                    return

    async def _snapshot(self, job_id: str) -> Look:
        snapshot = await self.records.look(job_id)
        if snapshot is None or not current().sees(snapshot.record.caller):
            raise UnknownJob
        return snapshot

    async def _has_gap(self, job_id: str, after: str, snapshot: Snapshot) -> bool:
        if place(after) > place(snapshot.last_event):
            return True  # an id of another life of this Redis
        if await self.events.has_gap(job_id, after):
            return place(after) != place(snapshot.last_event)
        if place(after) != place(START):
            return False
        first = await self.events.read(job_id, START, count=1)
        return not first or first[0].data != {"state": "queued", "attempt": 1}

    async def _replay(self, job_id: str, after: str, until: str) -> AsyncIterator[Event]:
        """Events after an id, at least up to another: the watcher has what follows."""
        while place(after) < place(until):
            events = await self.events.read(job_id, after, count=PAGE)
            for event in events:
                yield event
            after = events[-1].id if events else until


def place(event_id: str) -> tuple[int, int]:
    """Event ids in their order."""
    milliseconds, _, number = event_id.partition("-")
    return int(milliseconds), int(number or 0)


def _end(snapshot: Snapshot) -> Message:
    """The last event of a finished job, told from its record: streams outlive jobs only a day."""
    record = snapshot.record
    data: dict[str, Any] = {"state": record.state, "attempt": record.attempt}
    if record.error is not None:
        data["error"] = vars(record.error)
    return Message(snapshot.last_event, "end", record.finished_at or time.time(), data)
