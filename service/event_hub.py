"""One reader of Redis per process, any number of clients behind it."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from redis.exceptions import RedisError

from jobs.events import AsyncEvents
from service.event_message import Message

log = logging.getLogger("service")

MAX_PENDING = 512
# A new job joins the reader's list between two reads, so this bounds how late it can be.
BLOCK_MS = 250
RETRY_S = 1.0
_AT_A_TIME = 5


class Overflow(Exception):
    """The client reads so slowly that states would have to be skipped."""


class Watcher:
    """The events one client has not taken yet.

    Waiting progress is replaced by newer progress, a waiting preview by the next of its kind;
    everything else is kept in order. A client
    that lets MAX_PENDING events pile up is cut off: it can resume at the last id it has seen.

    since: every event after this id will be offered.
    """

    def __init__(self, since: str) -> None:
        self.since = since
        self._pending: deque[Message] = deque()
        self._arrived = asyncio.Event()
        self._overflowed = False

    def offer(self, event: Message) -> None:
        """Adds an event without ever waiting."""
        if event.type == "progress" and self._pending and self._pending[-1].type == "progress":
            self._pending.pop()
        if event.type == "preview":
            self._forget_previews(event.data.get("kind"))
        if len(self._pending) >= MAX_PENDING:
            self._overflowed = True
            self._pending.clear()
        if not self._overflowed:
            self._pending.append(event)
        self._arrived.set()

    def _forget_previews(self, kind: object) -> None:
        older = [e for e in self._pending if e.type == "preview" and e.data.get("kind") == kind]
        for event in older:
            self._pending.remove(event)

    async def next(self, timeout_s: float) -> Message | None:
        """The next event, or None when none came in time.

        Raises:
            Overflow: the client was too slow.
        """
        if not self._pending and not self._overflowed:
            self._arrived.clear()
            try:
                async with asyncio.timeout(timeout_s):
                    await self._arrived.wait()
            except TimeoutError:
                return None
        if self._overflowed:
            raise Overflow
        return self._pending.popleft()


class _Channel:
    """The watchers of one job, and how far the reader has come in its stream."""

    def __init__(self, last_id: str) -> None:
        self.last_id = last_id
        self.watchers: set[Watcher] = set()


class EventHub:
    """Reads the streams of all watched jobs in one loop and fans the events out."""

    def __init__(self, events: AsyncEvents) -> None:
        self._events = events
        self._channels: dict[str, _Channel] = {}
        self._wanted = asyncio.Event()

    @contextmanager
    def watch(self, job_id: str, known_id: str) -> Iterator[Watcher]:
        """A watcher that gets every event after `watcher.since`.

        known_id: an event id of the job that was read before this call. What the client wants up
        to `since` is read with AsyncEvents.read; what comes both ways is told apart by its id.
        """
        channel = self._channels.setdefault(job_id, _Channel(known_id))
        watcher = Watcher(channel.last_id)
        channel.watchers.add(watcher)
        self._wanted.set()
        try:
            yield watcher
        finally:
            channel.watchers.discard(watcher)
            if not channel.watchers:
                self._channels.pop(job_id, None)

    def watcher_count(self) -> int:
        """How many clients are watching."""
        return sum(len(channel.watchers) for channel in self._channels.values())

    async def run(self) -> None:
        """Reads until cancelled; a Redis that is away delays events and loses none."""
        while True:
            while not self._channels:
                self._wanted.clear()
                await self._wanted.wait()
            try:
                await self._read_once()
            except RedisError as error:
                log.warning("events wait for redis: %s", error)
                await asyncio.sleep(RETRY_S)

    async def _read_once(self) -> None:
        known = {job_id: channel.last_id for job_id, channel in self._channels.items()}
        found = await self._events.read_many(known, block_ms=BLOCK_MS)
        for job_id, events in found.items():
            channel = self._channels.get(job_id)
            # the job may have been left and joined again meanwhile, at another place
            if channel is None or channel.last_id != known[job_id]:
                continue
            for event in events:
                # who joins from here on reads up to this event without the hub
                channel.last_id = event.id
                await _offer(Message.of(event), tuple(channel.watchers))


async def _offer(message: Message, watchers: Sequence[Watcher]) -> None:
    """Hands the same message, which is encoded once, to all of them, a few at a time: between them
    the process answers others, who would wait for hundreds of sends otherwise."""
    for start in range(0, len(watchers), _AT_A_TIME):
        for watcher in watchers[start : start + _AT_A_TIME]:
            watcher.offer(message)
        await asyncio.sleep(0)
