"""The newest picture of a running fit: frames that the worker draws and the page shows.

Redis keeps one frame of each kind a job; a newer one takes its place. An event `preview` says
that there is one. A frame is little-endian:

    offset  type      meaning
    0       4 bytes   "UDFP"
    4       u8        version, 1
    5       u8        kind: 1 points, 2 mesh
    6       u16       flags: 1 a round for each point
    8       u32       sequence; grows within a job
    12      u32       points, or vertices
    16      u32       triangles, 0 for points
    20      u32       points of the whole cloud, of which these are a choice
    24      u16, u16  round, rounds
    28      u32       0
    32      f64 x 3   origin
    56      f64       scale: position = origin + scale * (u16 / 65535)
    64      u16 x 3   for each point or vertex its position
    then    u32 x 3   for each triangle its vertices
    then    u8        for each point its round

Each part begins at a multiple of four bytes.
"""

from __future__ import annotations

import struct
from typing import Any, Literal, get_args

import redis
import redis.asyncio

from jobs import keys

Kind = Literal["points", "mesh"]
KINDS: tuple[Kind, ...] = get_args(Kind)
MAX_BYTES = 2 << 20
_SEQUENCE = struct.Struct("<I")
_SEQUENCE_AT = 8


class Previews:
    """Writing, for the worker."""

    def __init__(self, connection: redis.Redis) -> None:
        self._redis: Any = connection

    def put(self, job_id: str, kind: Kind, frame: bytes) -> None:
        """Keep a frame in the place of the one before.

        Raises:
            ValueError: it is larger than MAX_BYTES.
        """
        if len(frame) > MAX_BYTES:
            raise ValueError(f"a frame has {len(frame)} bytes; at most {MAX_BYTES} are sent")
        self._redis.set(keys.preview(job_id, kind), frame, ex=keys.PREVIEW_LIFE_S)

    def is_watched(self, job_id: str) -> bool:
        """Whether anybody looks at frames of this job now."""
        return bool(self._redis.exists(keys.watched(job_id)))


class AsyncPreviews:
    """Reading, for the API. connection: with answers in bytes."""

    def __init__(self, connection: redis.asyncio.Redis) -> None:
        self._redis: Any = connection

    async def get(self, job_id: str, kind: Kind) -> bytes | None:
        """The newest frame, None if there is none (any more)."""
        found: bytes | None = await self._redis.get(keys.preview(job_id, kind))
        return found

    async def mark_watched(self, job_id: str) -> None:
        """Say that somebody looks; good for WATCHED_LIFE_S."""
        await self._redis.set(keys.watched(job_id), b"1", ex=keys.WATCHED_LIFE_S)


def sequence_of(frame: bytes) -> int:
    """The number of a frame."""
    number: int = _SEQUENCE.unpack_from(frame, _SEQUENCE_AT)[0]
    return number
