"""The dual surface of crossed lattice edges: a vertex per sheet in each cell, a quad per edge."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from udflow.mesh.crossings import Crossings
from udflow.mesh.lattice import Lattice, decode, shifted

# The four cells around an edge along axis a, in cyclic order, as steps back along the two axes
# that follow a.
_AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))
_FIXED_POINT = 1 << 24


@dataclass(frozen=True)
class DualSurface:
    """Quads over vertices that lie one per sheet in each cell.

    Attributes:
        vertices: (v, 3) float32, means of the crossings around them, unit frame.
        quads: (q, 4) int64, in cyclic order, orientation arbitrary.
    """

    vertices: Tensor
    quads: Tensor


def dual_surface(lattice: Lattice, crossings: Crossings) -> DualSurface:
    """One vertex per connected group of crossings of a cell and one quad per crossed edge."""
    cell_keys = _cells_around_edges(crossings.keys, crossings.axis)
    cells, cell = torch.unique(cell_keys, return_inverse=True)
    local = _local_edges(crossings.axis)
    mask = torch.zeros_like(cells).index_add_(0, cell.reshape(-1), (1 << local).reshape(-1))
    groups, count = (table.to(cells.device) for table in group_table())
    first = torch.cumsum(count[mask], dim=0) - count[mask]
    quads = first[cell] + groups[mask[cell], local]
    vertices = _mean_crossings(lattice, crossings, quads, int(count[mask].sum()))
    return DualSurface(vertices, quads)


def _cells_around_edges(keys: Tensor, axis: Tensor) -> Tensor:
    """(e, 4) keys of the cells around the edges that start at the given vertices."""
    result = torch.empty((*keys.shape, 4), dtype=torch.int64, device=keys.device)
    for a in range(3):
        chosen = (axis == a).nonzero()[:, 0]
        b, c = (a + 1) % 3, (a + 2) % 3
        here = keys[chosen]
        back_b, back_c = shifted(here, b, -1), shifted(here, c, -1)
        both = shifted(back_b, c, -1)
        result[chosen] = torch.stack([here, back_b, both, back_c], dim=1)
    return result


def _local_edges(axis: Tensor) -> Tensor:
    """(e, 4) number 0..11 that each edge has in the four cells around it."""
    number = torch.tensor([b + 2 * c for b, c in _AROUND], device=axis.device)
    return 4 * axis[:, None] + number


def _mean_crossings(lattice: Lattice, crossings: Crossings, quads: Tensor, count: int) -> Tensor:
    """(count, 3) mean crossing of each group.

    Sums run over integers so that their order, which parallel devices vary, does not matter.
    """
    along = torch.nn.functional.one_hot(crossings.axis, 3) * crossings.where[:, None]
    fixed = (along * _FIXED_POINT).long() + decode(crossings.keys) * _FIXED_POINT
    corner = quads.reshape(-1)
    total = fixed.new_zeros(count, 3).index_add_(0, corner, fixed.repeat_interleave(4, dim=0))
    members = torch.bincount(corner, minlength=count)[:, None]
    whole = total // (members * _FIXED_POINT)
    fraction = (total - whole * members * _FIXED_POINT).double() / (members * _FIXED_POINT)
    offset = (whole + fraction) * lattice.step
    return (lattice.origin.double() + offset).float()


@cache
def group_table() -> tuple[Tensor, Tensor]:
    """How the crossed edges of a cell fall into connected groups.

    Returns:
        (4096, 12) int64 group of each crossed edge, by the bit mask of the crossed edges, and
        (4096,) int64 number of groups.

    Edge 4a + b + 2c runs along axis a at offset b, c along the axes that follow a. Crossed edges
    of one cell face are connected; where all four are crossed, the two that meet at the face's
    lowest corner and the two that meet at its highest, so that the cells on both sides agree.
    """
    mask = torch.arange(4096)
    crossed = (mask[:, None] >> torch.arange(12)) & 1 == 1
    label = torch.where(crossed, torch.arange(12), 12)
    for _ in range(6):
        for face in _cell_faces():
            label = _joined(label, crossed, face)
    return _numbered(label, crossed)


def _joined(label: Tensor, crossed: Tensor, face: tuple[int, int, int, int]) -> Tensor:
    """Labels after connecting the crossed edges of one face."""
    all_four = crossed[:, list(face)].all(dim=1)
    label = label.clone()
    for edges, applies in ((face, ~all_four), (face[:2], all_four), (face[2:], all_four)):
        columns = list(edges)
        lowest = label[:, columns].amin(dim=1, keepdim=True)
        member = crossed[:, columns] & applies[:, None]
        label[:, columns] = torch.where(member, lowest, label[:, columns])
    return label


def _cell_faces() -> list[tuple[int, int, int, int]]:
    """Edge numbers of the six faces: two at the lowest corner, two at the highest."""
    faces = []
    for a in range(3):  # the face spanned by the axes b and c, at both ends of axis a
        b, c = (a + 1) % 3, (a + 2) % 3
        for at in (0, 1):
            # edge along b: its following axes are c, a; edge along c: they are a, b
            low_b, high_b = 4 * b + 2 * at, 4 * b + 1 + 2 * at
            low_c, high_c = 4 * c + at, 4 * c + at + 2
            faces.append((low_b, low_c, high_b, high_c))
    return faces


def _numbered(label: Tensor, crossed: Tensor) -> tuple[Tensor, Tensor]:
    """Labels to consecutive group numbers, and how many there are."""
    leads = crossed & (label == torch.arange(12))
    number = torch.cumsum(leads, dim=1) - 1
    group = number.gather(1, label.clamp_max(11))
    return torch.where(crossed, group, 0), leads.sum(dim=1)


def triangles(vertices: Tensor, quads: Tensor) -> Tensor:
    """(2q, 3) triangles of (q, 4) quads, each cut along its better diagonal.

    Better is the cut whose two triangles agree more in their normals; on creases this follows
    the crease.
    """
    corner = vertices[quads]
    cut_02 = _agreement(corner[:, [0, 1, 2]], corner[:, [0, 2, 3]])
    cut_13 = _agreement(corner[:, [1, 2, 3]], corner[:, [1, 3, 0]])
    first = quads[:, [0, 1, 2, 0, 2, 3]]
    second = quads[:, [1, 2, 3, 1, 3, 0]]
    return torch.where((cut_02 >= cut_13)[:, None], first, second).reshape(-1, 3)


def _agreement(one: Tensor, two: Tensor) -> Tensor:
    """Cosine between the normals of (q, 3, 3) triangles."""
    normal = [torch.linalg.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (one, two)]
    return torch.nn.functional.cosine_similarity(normal[0], normal[1], dim=1, eps=1e-30)
