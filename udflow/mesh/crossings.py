"""Which lattice edges the surface crosses: one flag per edge, decided once.

With an unsigned normal n and a signed height s = d·n at every vertex, the edge ab is crossed where
s_a s_b sign(n_a·n_b) < 0. Around a lattice face the signs of the heights cancel, so the number of
crossed edges is even wherever the normals agree, and the surface closes by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.mesh.band import Band
from udflow.mesh.normals import band_normals

REPAIRS = 6
_PLANES = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Crossings:
    """Crossed lattice edges.

    Attributes:
        vertex: (e,) int64 index in the band of the lower end of each crossed edge.
        axis: (e,) int64 direction of the edge.
        where: (e,) float32 position of the crossing along the edge, 0..1.
        normals: (n, 3) float32 unit normals of arbitrary sign at all vertices of the band.
    """

    vertex: Tensor
    axis: Tensor
    where: Tensor
    normals: Tensor


def find_crossings(band: Band) -> Crossings:
    """The lattice edges of the band that the surface crosses."""
    normals = band_normals(band)
    displacement = band.lattice.positions(band.keys) - band.feet
    height = (displacement * normals).sum(dim=1)
    columns = [_crossed(band, axis, height, normals) for axis in range(3)]
    flags = _repaired(torch.stack(columns, dim=1), band)
    vertex, axis = flags.nonzero().unbind(1)
    near, far = height[vertex].abs(), height[band.ahead[vertex, axis]].abs()
    where = near / (near + far).clamp_min(1e-12)
    return Crossings(vertex, axis, where, normals)


def _crossed(band: Band, axis: int, height: Tensor, normals: Tensor) -> Tensor:
    """(n,) whether the edge from each vertex along an axis is crossed."""
    near = (band.ahead[:, axis] >= 0).nonzero()[:, 0]
    far = band.ahead[near, axis]
    normal = normals[near]
    opposed = (normal * normals[far]).sum(dim=1) < 0
    flag = (height[near] < 0) ^ (height[far] < 0) ^ opposed
    # Feet on different sheets: between close layers the heights change sign without a surface.
    # Looser than it looks; a strict test would undo the parity of the flags.
    apart = ((band.feet[far] - band.feet[near]) * normal).sum(dim=1).abs()
    allowed = 0.5 * (height[near].abs() + height[far].abs()) + 0.5 * band.lattice.step
    crossed = torch.zeros_like(band.keys, dtype=torch.bool)
    crossed[near] = flag & (apart <= allowed)
    return crossed


def _repaired(flags: Tensor, band: Band) -> Tensor:
    """Flags (n, 3) after flipping edges at which three or all four faces are odd.

    One wrong flag makes its four faces odd. A true border or a junction of sheets makes at most
    two and is left alone.
    """
    exists = band.ahead >= 0
    for _ in range(REPAIRS):
        wrong = (_odd_faces_per_edge(flags, band) >= 3) & exists
        if not bool(wrong.any()):
            break
        flags = flags ^ wrong
    return flags


def _odd_faces_per_edge(flags: Tensor, band: Band) -> Tensor:
    """(n, 3) how many of the four faces at each edge have an odd number of crossed edges."""
    padded = torch.cat([flags, flags.new_zeros(1, 3)])
    count = torch.zeros_like(flags, dtype=torch.int8)
    for a, b in _PLANES:
        odd = flags[:, a] ^ flags[:, b] ^ padded[band.ahead[:, a], b] ^ padded[band.ahead[:, b], a]
        spread = torch.cat([odd, odd.new_zeros(1)])
        count[:, a] += odd.to(torch.int8) + spread[band.behind[:, b]]
        count[:, b] += odd.to(torch.int8) + spread[band.behind[:, a]]
    return count
