"""Preview frames: coordinates in 16 bits an axis. The layout stands in `jobs/previews.py`."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from udflow.progress import CoarseMesh, GrownCloud

MAX_POINTS = 120_000
MAX_VERTICES = 60_000
_HEADER = struct.Struct("<4sBBHIIIIHHI3dd")
_VERSION, _POINTS, _MESH = 1, 1, 2
_HAS_ROUNDS = 1
_CODES = 65535.0


def points_frame(cloud: GrownCloud, sequence: int, rounds: int) -> bytes:
    """A cloud, at most MAX_POINTS of it, taken evenly.

    rounds: how many there will be.
    """
    total = len(cloud.points)
    chosen = np.arange(total)
    if total > MAX_POINTS:
        chosen = np.linspace(0, total - 1, MAX_POINTS).astype(np.int64)
    born = cloud.rounds[chosen]
    codes, origin, scale = _quantised(cloud.points[chosen])
    header = _HEADER.pack(
        *(b"UDFP", _VERSION, _POINTS, _HAS_ROUNDS, sequence, len(chosen), 0, total),
        *(int(cloud.rounds[-1]), rounds, 0, *origin, scale),
    )
    return b"".join([header, _part(codes), _part(np.minimum(born, 255).astype(np.uint8))])


def mesh_frame(mesh: CoarseMesh, sequence: int, round_: int, rounds: int) -> bytes | None:
    """A mesh; None if it has more than MAX_VERTICES."""
    count = len(mesh.vertices)
    if count > MAX_VERTICES:
        return None
    codes, origin, scale = _quantised(mesh.vertices)
    header = _HEADER.pack(
        *(b"UDFP", _VERSION, _MESH, 0, sequence, count, len(mesh.faces), count),
        *(round_, rounds, 0, *origin, scale),
    )
    return b"".join([header, _part(codes), _part(mesh.faces.astype("<u4"))])


def _quantised(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.uint16], tuple[float, float, float], float]:
    """Codes, the low corner and the extent: one scale for all axes."""
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max()) or 1.0
    codes = np.rint((points - low) / extent * _CODES).astype("<u2")
    return codes, (float(low[0]), float(low[1]), float(low[2])), extent


def _part(values: NDArray[np.unsignedinteger]) -> bytes:
    data = values.tobytes()
    return data + bytes(-len(data) % 4)
