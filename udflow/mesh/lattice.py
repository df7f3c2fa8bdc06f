"""A regular lattice of points of which only a sparse set is ever stored.

A lattice vertex (i, j, k) is one int64 key with the bits of i, j and k interleaved (Morton
order). Sorted keys keep neighbours close in memory, the eight children of a cell follow each
other, and a set of vertices is just a sorted tensor of keys.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

BITS = 12  # per axis: 4096 vertices, resolution 1024 and ample room around it
_AXIS_MASK = (
    sum(1 << (3 * bit + 2) for bit in range(BITS)),
    sum(1 << (3 * bit + 1) for bit in range(BITS)),
    sum(1 << (3 * bit) for bit in range(BITS)),
)
_ALL = _AXIS_MASK[0] | _AXIS_MASK[1] | _AXIS_MASK[2]


@dataclass(frozen=True)
class Lattice:
    """Where the vertices lie.

    Attributes:
        origin: (3,) float32, position of vertex (0, 0, 0), unit frame.
        step: distance of neighbouring vertices, one voxel.
    """

    origin: Tensor
    step: float

    @classmethod
    def around(cls, samples: Tensor, resolution: int) -> Lattice:
        """The lattice with `resolution` cells along the largest extent of (m, 3) samples."""
        low, high = samples.amin(dim=0), samples.amax(dim=0)
        step = float((high - low).max()) / resolution
        # a vertex layer in a flat face of the shape would put crossings on its vertices
        shift = torch.tensor([0.37, 0.41, 0.43], device=samples.device, dtype=samples.dtype)
        centre = 0.5 * (low + high)
        return cls(origin=centre - (2 ** (BITS - 1) + shift) * step, step=step)

    def positions(self, keys: Tensor, level: int = 0) -> Tensor:
        """(n, 3) centres of the 2^level vertices a side that cells of this level hold."""
        width = 1 << level
        return self.origin + (decode(keys) * width + 0.5 * (width - 1)) * self.step

    def keys(self, points: Tensor, level: int = 0) -> Tensor:
        """(n,) cells of this level that hold (n, 3) points; level 0: the nearest vertices."""
        vertex = torch.round((points - self.origin) / self.step).long()
        return encode(vertex.clamp_(0, (1 << BITS) - 1) >> level)


def encode(coordinates: Tensor) -> Tensor:
    """(n, 3) int64 coordinates to (n,) keys."""
    x, y, z = coordinates.unbind(-1)
    return (_spread(x) << 2) | (_spread(y) << 1) | _spread(z)


def decode(keys: Tensor) -> Tensor:
    """(n,) keys to (n, 3) int64 coordinates."""
    return torch.stack([_gather(keys >> 2), _gather(keys >> 1), _gather(keys)], dim=-1)


def shifted(keys: Tensor, axis: int, by: int) -> Tensor:
    """Keys of the neighbours one vertex on (by = 1) or back (by = -1) along an axis.

    The bits of the other axes are filled so that the carry runs through them.
    """
    mask = _AXIS_MASK[axis]
    moved = (keys | (_ALL ^ mask)) + 1 if by == 1 else (keys & mask) - 1
    return (moved & mask) | (keys & (_ALL ^ mask))


def children(keys: Tensor) -> Tensor:
    """(8n,) sorted cells of the next finer level inside (n,) sorted cells."""
    return ((keys << 3)[:, None] + torch.arange(8, device=keys.device)).reshape(-1)


def find(keys: Tensor, wanted: Tensor) -> Tensor:
    """(n,) int64 positions of `wanted` in the sorted `keys`; -1 where a key is absent."""
    if keys.numel() == 0:
        return torch.full_like(wanted, -1)
    place = torch.searchsorted(keys, wanted).clamp_max_(keys.numel() - 1)
    return torch.where(keys[place] == wanted, place, -1)


def distinct(keys: Tensor) -> Tensor:
    """(m,) sorted keys, each once, of (n,) keys."""
    if keys.device.type == "cpu":  # NumPy sorts whole numbers several times as fast
        return torch.unique_consecutive(torch.from_numpy(np.sort(keys.numpy())))
    return torch.unique(keys)


def dilated(keys: Tensor) -> Tensor:
    """Sorted keys together with their 26 neighbours."""
    for axis in range(3):
        keys = distinct(torch.cat([keys, shifted(keys, axis, 1), shifted(keys, axis, -1)]))
    return keys


def reversed_links(ahead: Tensor) -> Tensor:
    """(n, 3) index of the previous vertex along each axis, from that of the next; -1 for none."""
    behind = torch.full_like(ahead, -1)
    for axis in range(3):
        has = (ahead[:, axis] >= 0).nonzero()[:, 0]
        behind[ahead[has, axis], axis] = has
    return behind


def _spread(value: Tensor) -> Tensor:
    """Bits b of a 12-bit number to bits 3b."""
    value = (value | (value << 16)) & 0x0000_00FF_0000_FF
    value = (value | (value << 8)) & 0x00F_00F_00F_00F
    value = (value | (value << 4)) & 0x0C3_0C3_0C3_0C3
    return (value | (value << 2)) & 0x249_249_249_249


def _gather(value: Tensor) -> Tensor:
    """Bits 3b of a key to bits b."""
    value = value & 0x249_249_249_249
    value = (value | (value >> 2)) & 0x0C3_0C3_0C3_0C3
    value = (value | (value >> 4)) & 0x00F_00F_00F_00F
    value = (value | (value >> 8)) & 0x0000_00FF_0000_FF
    return (value | (value >> 16)) & 0xFFF
