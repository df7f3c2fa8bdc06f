"""Marching cubes with signs decided cell by cell: the extraction of CAP-UDF (Zhou et al., 2022).

Kept for the paper's protocol. In each cell near the surface a corner counts as negative if its
gradient opposes that of the cell's first corner. Cells decide for themselves, so neighbours may
disagree; then the surface cracks. Evaluated sparsely, with shared vertices.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

from udflow.fields.interface import ProjectiveField
from udflow.mesh.band import Band, find_band
from udflow.mesh.lattice import Lattice, distinct, find, shifted

NEAR = 1.2  # voxels: cells with a corner this near are marched (0.005 at 256 cells in CAP-UDF)
FAR = 0.01  # unit frame: faces farther from the samples on average are dropped
FAR_SPACINGS = 2.0  # but none nearer than this many sample spacings

_CORNERS = tuple((i & 1, i >> 1 & 1, i >> 2 & 1) for i in range(8))
# (first corner, axis) of the twelve edges; the second corner lies one step along the axis
_EDGES = tuple((corner, axis) for axis in range(3) for corner in range(8) if not corner >> axis & 1)


def marched(
    field: ProjectiveField, samples: Tensor, spacing: Tensor, lattice: Lattice
) -> tuple[Tensor, Tensor]:
    """Vertices (v, 3) and triangles (f, 3) of arbitrary orientation by CAP-UDF's marching.

    Args:
        field: the surface.
        samples: (m, 3) points that the surface is known to pass near.
        spacing: (m,) local distance of neighbouring samples.
        lattice: whose cells are marched.
    """
    band = find_band(field, samples, spacing, lattice, NEAR + 3**0.5)
    displacement = lattice.positions(band.keys) - band.feet
    distance = torch.linalg.vector_norm(displacement, dim=1)
    corners = _cells(band, distance)
    opposed = (displacement[corners] * displacement[corners[:, :1]]).sum(dim=2) < 0
    case = (opposed << torch.arange(8, device=opposed.device)).sum(dim=1)
    return _triangulated(band, distance, corners, triangle_table().to(case.device)[case])


def _cells(band: Band, distance: Tensor) -> Tensor:
    """(c, 8) corners of the cells near the surface, those with all corners in the band."""
    lowest = band.keys[distance <= NEAR * band.lattice.step]
    for axis in range(3):
        lowest = distinct(torch.cat([lowest, shifted(lowest, axis, -1)]))
    columns = []
    for steps in _CORNERS:
        keys = lowest
        for axis in range(3):
            keys = shifted(keys, axis, 1) if steps[axis] else keys
        columns.append(find(band.keys, keys))
    corners = torch.stack(columns, dim=1)
    return corners[(corners >= 0).all(dim=1)]


def _triangulated(
    band: Band, distance: Tensor, corners: Tensor, edges: Tensor
) -> tuple[Tensor, Tensor]:
    """Vertices and triangles from (c, t, 3) edge numbers per cell, -1 where there is none."""
    cell, which = (edges[:, :, 0] >= 0).nonzero().unbind(1)
    edge = edges[cell, which]
    start, axis = torch.tensor(_EDGES, device=edge.device)[edge].unbind(-1)
    low = corners[cell[:, None], start]
    number, faces = torch.unique(3 * low + axis, return_inverse=True)
    low, axis = number // 3, number % 3
    high = band.ahead[low, axis]
    where = distance[low] / (distance[low] + distance[high]).clamp_min(1e-12)
    one, two = band.lattice.positions(band.keys[low]), band.lattice.positions(band.keys[high])
    return one + where[:, None] * (two - one), faces


@cache
def triangle_table() -> Tensor:
    """(256, t, 3) edge numbers of the triangles for each set of negative corners (bit i for
    corner i), padded with -1.

    Derived, not copied: on each face the crossed edges are joined in pairs, where all four are
    crossed the two at each negative corner; the joints form loops, which are cut into fans.
    """
    rows = [_fans(_loops(case)) for case in range(256)]
    table = np.full((256, max(len(row) for row in rows), 3), -1, dtype=np.int64)
    for case, row in enumerate(rows):
        table[case, : len(row)] = np.reshape(row, (-1, 3))
    return torch.from_numpy(table)


def _loops(case: int) -> list[list[int]]:
    """Cycles of crossed edges around a cell."""
    joined: dict[int, list[int]] = {}
    for face in _faces():
        for one, two in _joints(face, case):
            joined.setdefault(one, []).append(two)
            joined.setdefault(two, []).append(one)
    loops = []
    while joined:
        edge = min(joined)
        loop = []
        while edge in joined:
            loop.append(edge)
            onward = joined.pop(edge)
            edge = next((e for e in onward if e in joined), -1)
        loops.append(loop)
    return loops


def _joints(face: tuple[int, int, int, int], case: int) -> list[tuple[int, int]]:
    """Pairs of crossed edges on a face, given its corners in cyclic order."""
    negative = [bool(case >> corner & 1) for corner in face]
    edges = [_edge_between(face[i], face[(i + 1) % 4]) for i in range(4)]
    crossed = [i for i in range(4) if negative[i] != negative[(i + 1) % 4]]
    if len(crossed) == 4:
        return [(edges[i - 1], edges[i]) for i in range(4) if negative[i]]
    return [(edges[crossed[0]], edges[crossed[1]])] if crossed else []


def _faces() -> list[tuple[int, int, int, int]]:
    """Corners of the six faces in cyclic order."""
    faces = []
    for axis in range(3):
        b, c = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        faces += [(base, base | b, base | b | c, base | c) for base in (0, 1 << axis)]
    return faces


def _edge_between(one: int, two: int) -> int:
    axis = (one ^ two).bit_length() - 1
    return _EDGES.index((min(one, two), axis))


def _fans(loops: list[list[int]]) -> list[tuple[int, int, int]]:
    return [(loop[0], loop[i], loop[i + 1]) for loop in loops for i in range(1, len(loop) - 1)]
