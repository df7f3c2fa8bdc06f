"""Preview frames on their way to clients: fetched once a process, sent to each at most once."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import AsyncIterator

from jobs.keys import WATCHED_LIFE_S
from jobs.previews import KINDS, AsyncPreviews, Kind, sequence_of
from service.event_message import Message

_KEPT = 32  # frames of at most 2 MB


class SharedFrames:
    """The newest frames of the jobs that are watched."""

    def __init__(self, previews: AsyncPreviews) -> None:
        self._previews = previews
        self._frames: OrderedDict[tuple[str, Kind], bytes] = OrderedDict()
        self._fetching = asyncio.Lock()

    async def at_least(self, job_id: str, kind: Kind, sequence: int) -> bytes | None:
        """A frame of this number or a later one; None if it is gone."""
        async with self._fetching:
            known = self._frames.get((job_id, kind))
            if known is not None and sequence_of(known) >= sequence:
                self._frames.move_to_end((job_id, kind))
                return known
            found = await self._previews.get(job_id, kind)
            if found is not None:
                self._frames[job_id, kind] = found
                self._frames.move_to_end((job_id, kind))
                while len(self._frames) > _KEPT:
                    self._frames.popitem(last=False)
            return found

    async def mark_watched(self, job_id: str) -> None:
        """Say that somebody looks."""
        await self._previews.mark_watched(job_id)


class FrameReader:
    """What one client of one job gets to see."""

    def __init__(self, frames: SharedFrames, job_id: str) -> None:
        self._frames = frames
        self._job_id = job_id
        self._sent: dict[Kind, int] = {}
        self._mark_at = 0.0

    async def frames_for(self, message: Message) -> AsyncIterator[bytes]:
        """The frames to send after a message: what there is after a snapshot, then each new one.

        A client that is slow gets the newest when it is ready, and never an older one after it.
        """
        await self._stay_marked()
        if message.type == "snapshot":
            wanted: dict[Kind, int] = dict.fromkeys(KINDS, 1)
        elif message.type == "preview":
            wanted = {message.data["kind"]: message.data["sequence"]}
        else:
            return
        for kind, sequence in wanted.items():
            frame = await self._frames.at_least(self._job_id, kind, sequence)
            if frame is not None and sequence_of(frame) > self._sent.get(kind, 0):
                self._sent[kind] = sequence_of(frame)
                yield frame

    async def _stay_marked(self) -> None:
        now = time.monotonic()
        if now >= self._mark_at:
            self._mark_at = now + WATCHED_LIFE_S / 3
            await self._frames.mark_watched(self._job_id)
