"""The lattice vertices near the surface, found from coarse to fine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.fields.interface import ProjectiveField
from udflow.mesh.lattice import Lattice, children, dilated, find, reversed_links, shifted

CHUNK = 1 << 17  # points per call of the field: bounds its memory, large enough for its speed
MAX_DILATION = 8
REACH = 2.0  # spacings: farther from all samples nothing is known


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
    return torch.cat([field.project(part) for part in torch.split(points, CHUNK)])


def find_band(
    field: ProjectiveField, samples: Tensor, spacing: Tensor, lattice: Lattice, width: float
) -> Band:
    """All lattice vertices within `width` voxels of the surface near the samples.

    Args:
        field: the surface.
        samples: (m, 3) points that the surface is known to pass near.
        spacing: (m,) local distance of neighbouring samples; surface farther than REACH spacings
            from every sample is not looked for.
        lattice: the vertices to choose from.
        width: in voxels.
    """
    reach = REACH * spacing
    level = _coarsest_level(float(reach.median()), lattice.step)
    cells = _cells_around(samples, reach, lattice, level)
    while level > 0:
        half_diagonal = 0.5 * math.sqrt(3) * ((1 << level) - 1)
        near, _ = _near(field, lattice, cells, level, half_diagonal + width)
        cells = children(cells[near])
        level -= 1
    near, feet = _near(field, lattice, cells, 0, width)
    return _band(lattice, cells[near], feet[near])


@dataclass(frozen=True)
class Patch:
    """Part of a band, made wider.

    Attributes:
        band: the patch.
        inner: (n,) bool, vertices with all the neighbours that they would have in a whole band.
        source: (n,) int64 index in the band it was taken from, -1 for added vertices.
    """

    band: Band
    inner: Tensor
    source: Tensor


def widened(field: ProjectiveField, band: Band, around: Tensor, reach: int, width: float) -> Patch:
    """A patch of the band in which vertices within `width` voxels of the surface are added.

    Args:
        field: the surface.
        band: the band to take the patch from.
        around: (k,) sorted keys of vertices.
        reach: how many vertices away from them to add more.
        width: in voxels, less than one more than that of the band.
    """
    grown = [around]
    for _ in range(reach + 3):  # added vertices change normals, and those change flags beyond
        grown.append(dilated(grown[-1]))
    place = find(band.keys, grown[-1])
    old = place[place >= 0]
    missing = grown[reach][find(band.keys, grown[reach]) < 0]
    # Only these can lie near enough: a neighbour of theirs is a voxel nearer, and in the band. One
    # more is for creases, where feet leap from neighbour to neighbour.
    missing = missing[find(dilated(dilated(band.keys[old])), missing) >= 0]
    near, feet = _near(field, band.lattice, missing, 0, width)
    keys, order = torch.sort(torch.cat([band.keys[old], missing[near]]))
    feet = torch.cat([band.feet[old], feet[near]])[order]
    source = torch.cat([old, torch.full_like(missing[near], -1)])[order]
    return Patch(_band(band.lattice, keys, feet), find(grown[reach + 2], keys) >= 0, source)


def _near(
    field: ProjectiveField, lattice: Lattice, cells: Tensor, level: int, width: float
) -> tuple[Tensor, Tensor]:
    """(n,) whether cell centres lie within `width` voxels of the surface, and their (n, 3) feet."""
    centres = lattice.positions(cells, level)
    feet = project_in_chunks(field, centres)
    distance = torch.linalg.vector_norm(centres - feet, dim=1)
    return distance <= width * lattice.step, feet


def _band(lattice: Lattice, keys: Tensor, feet: Tensor) -> Band:
    ahead = torch.stack([find(keys, shifted(keys, axis, 1)) for axis in range(3)], dim=1)
    return Band(lattice, keys, feet, ahead, reversed_links(ahead))


def _coarsest_level(reach: float, step: float) -> int:
    """Cells at least as wide as the reach, so that one ring around a sample's cell covers it."""
    return max(1, min(6, math.ceil(math.log2(max(reach / step, 1.0)))))


def _cells_around(samples: Tensor, reach: Tensor, lattice: Lattice, level: int) -> Tensor:
    """Sorted cells of a level within `reach` (m,) of each of the (m, 3) samples."""
    width = lattice.step * (1 << level)
    rings = torch.ceil(reach / width).clamp_(1, MAX_DILATION).long()
    home = lattice.keys(samples, level)
    cells = home[:0]
    for ring in range(int(rings.max()), 0, -1):
        cells = dilated(torch.cat([cells, home[rings >= ring]]))
    return cells
