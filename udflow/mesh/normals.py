"""Unsigned surface normals at lattice vertices, from displacements to the surface.

The displacement of a vertex that lies almost on the surface has no usable direction. Averaging
the structure tensor over the neighbours, with longer displacements counting more, does.
"""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.mesh.band import Band

# (row, column) of the six entries that a symmetric 3 x 3 matrix is stored as
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def band_normals(band: Band) -> Tensor:
    """(n, 3) unit normals of arbitrary sign, one per vertex of the band.

    The main eigenvector of the mean of d dᵀ / (|d| + 0.3 h) over 27 lattice neighbours, where d is
    the displacement of a vertex from its foot and h the voxel.
    """
    displacement = band.lattice.positions(band.keys) - band.feet
    length = torch.linalg.vector_norm(displacement, dim=1)
    weight = 1.0 / (length + 0.3 * band.lattice.step)
    columns = [displacement[:, i] * displacement[:, j] * weight for i, j in _ENTRIES]
    return main_eigenvector(_summed_over_neighbours(torch.stack(columns, dim=1), band))


def _summed_over_neighbours(values: Tensor, band: Band) -> Tensor:
    """Box sums over 3 x 3 x 3 vertices, one axis at a time; absent vertices count as zero."""
    for axis in range(3):
        padded = torch.cat([values, values.new_zeros(1, values.shape[1])])
        # index -1 reads the row of zeros
        ahead = padded.index_select(0, band.ahead[:, axis] % padded.shape[0])
        behind = padded.index_select(0, band.behind[:, axis] % padded.shape[0])
        values = values + ahead + behind
    return values


def main_eigenvector(matrices: Tensor) -> Tensor:
    """(n, 3) unit eigenvectors to the largest eigenvalue.

    Args:
        matrices: (n, 6) positive semi-definite, entries xx, yy, zz, xy, xz, yz.

    Squaring a matrix squares the ratios of its eigenvalues: after seven squarings every column is
    a multiple of the main eigenvector, about ten times faster than a general eigensolver.
    """
    xx, yy, zz, xy, xz, yz = matrices.unbind(1)
    for _ in range(7):
        scale = 1.0 / (xx + yy + zz).clamp_min(1e-30)
        xx, yy, zz, xy, xz, yz = (v * scale for v in (xx, yy, zz, xy, xz, yz))
        xx, yy, zz, xy, xz, yz = (
            xx * xx + xy * xy + xz * xz,
            xy * xy + yy * yy + yz * yz,
            xz * xz + yz * yz + zz * zz,
            xx * xy + xy * yy + xz * yz,
            xx * xz + xy * yz + xz * zz,
            xy * xz + yy * yz + yz * zz,
        )
    longest = torch.stack([xx, yy, zz], dim=1).argmax(dim=1)
    rows = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], dim=1).view(-1, 3, 3)
    vector = rows.gather(1, longest.view(-1, 1, 1).expand(-1, 1, 3))[:, 0]
    return torch.nn.functional.normalize(vector, dim=1, eps=1e-30)
