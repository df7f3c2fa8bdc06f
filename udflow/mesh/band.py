"""The lattice vertices near the surface, found from coarse to fine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.fields.interface import ProjectiveField
from udflow.mesh.lattice import Lattice, children, dilated, find, shifted

CHUNK = 1 << 17  # points per call of the field: bounds its memory, large enough for its speed
MAX_DILATION = 8


@dataclass(frozen=True)
class Band:
    """Lattice vertices within a given distance of the surface.

    Attributes:
        lattice: where the vertices lie.
        keys: (n,) int64 sorted vertices.
        feet: (n, 3) float32 their nearest surface points by the field.
        ahead: (n, 3) int64 index of the next vertex along x, y, z, or -1.
        behind: (n, 3) int64 index of the previous vertex along x, y, z, or -1.
    """

    lattice: Lattice
    keys: Tensor
    feet: Tensor
    ahead: Tensor
    behind: Tensor


def project_in_chunks(field: ProjectiveField, points: Tensor) -> Tensor:
    """(n, 3) feet of (n, 3) points."""
    return torch.cat([field.project(part) for part in points.split(CHUNK)])


def find_band(
    field: ProjectiveField, samples: Tensor, spacing: Tensor, lattice: Lattice, width: float
) -> Band:
    """All lattice vertices within `width` voxels of the surface near the samples.

    Args:
        field: the surface.
        samples: (m, 3) points that the surface is known to pass near.
        spacing: (m,) local distance of neighbouring samples; surface farther than about three
            spacings from every sample is not looked for.
        lattice: the vertices to choose from.
        width: in voxels.
    """
    level = _coarsest_level(float(spacing.median()), lattice.step)
    cells = _cells_around(samples, 3.0 * spacing, lattice, level)
    while level > 0:
        centres = lattice.positions(cells, level)
        distance = _length(centres - project_in_chunks(field, centres))
        half_diagonal = 0.5 * math.sqrt(3) * ((1 << level) - 1)
        cells = children(cells[distance <= (half_diagonal + width) * lattice.step])
        level -= 1
    points = lattice.positions(cells)
    feet = project_in_chunks(field, points)
    near = _length(points - feet) <= width * lattice.step
    keys = cells[near]
    ahead = torch.stack([find(keys, shifted(keys, axis, 1)) for axis in range(3)], dim=1)
    return Band(lattice, keys, feet[near], ahead, _reversed(ahead))


def _length(vectors: Tensor) -> Tensor:
    return torch.linalg.vector_norm(vectors, dim=1)


def _coarsest_level(spacing: float, step: float) -> int:
    """Cells about as wide as the samples are apart, at least two voxels wide."""
    return max(1, min(6, round(math.log2(max(1.5 * spacing / step, 1.0)))))


def _cells_around(samples: Tensor, reach: Tensor, lattice: Lattice, level: int) -> Tensor:
    """Sorted cells of a level within `reach` (m,) of each of the (m, 3) samples."""
    width = lattice.step * (1 << level)
    rings = torch.ceil(reach / width).clamp_(1, MAX_DILATION).long()
    home = lattice.keys(samples, level)
    cells = home[:0]
    for ring in range(int(rings.max()), 0, -1):
        cells = dilated(torch.cat([cells, home[rings >= ring]]))
    return cells


def _reversed(ahead: Tensor) -> Tensor:
    """Who has me as its next vertex: (n, 3), -1 for nobody."""
    behind = torch.full_like(ahead, -1)
    for axis in range(3):
        has = (ahead[:, axis] >= 0).nonzero()[:, 0]
        behind[ahead[has, axis], axis] = has
    return behind
