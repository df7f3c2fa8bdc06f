"""A baseline of our own: moving least squares, one run a process: `mls.py CLOUD MESH RESOLUTION`.

The projection of Levin (2003): a reference plane by weighted principal components at the foot
so far, then a quadratic height over it, with Gaussian weights of one width everywhere. The mesh is
read off by udflow's own extraction, so what differs from udflow is the field alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.config import ExtractConfig
from udflow.mesh.export import write_mesh
from udflow.mesh.extract import extract
from udflow.mesh.mesh import Mesh

NEIGHBOURS = 40
WIDTH = 1.5  # standard deviation of the weights, in mean spacings
ROUNDS = 3  # of the reference plane
AT_ONCE = 1 << 14
TINY = 1e-12


class MovingLeastSquares:
    """The projection onto the surface of (m, 3) float32 samples in the unit frame."""

    def __init__(self, samples: Tensor) -> None:
        self._samples = samples.double()
        self._tree = cKDTree(self._samples.numpy())
        count = min(NEIGHBOURS, len(samples))
        distance, nearest = self._tree.query(self._samples.numpy(), k=count, workers=-1)
        self._neighbours = torch.from_numpy(nearest)
        # as many samples as lie in a disc of this radius, if they were evenly spread
        spacing = float(distance[:, min(8, count - 1)].mean()) * (np.pi / 9) ** 0.5
        self._width = WIDTH * spacing

    def project(self, points: Tensor) -> Tensor:
        """Feet (n, 3) of points (n, 3), unit frame."""
        return torch.cat([self._feet(part.double()) for part in points.split(AT_ONCE)]).to(points)

    def _feet(self, points: Tensor) -> Tensor:
        _, nearest = self._tree.query(points.numpy(), workers=-1)
        around = self._samples[self._neighbours[torch.from_numpy(nearest)]]
        foot = self._samples[nearest]
        for _ in range(ROUNDS):
            weights = self._weights(around, foot)
            centre, axes = _plane(around, weights)
            normal = axes[:, :, 0]
            foot = points - ((points - centre) * normal).sum(1, keepdim=True) * normal
        height = _height(around - foot[:, None], self._weights(around, foot), axes / self._width)
        return foot + self._width * height[:, None] * normal

    def _weights(self, around: Tensor, foot: Tensor) -> Tensor:
        """(n, k), relative to the nearest sample, so that none vanish far from all samples."""
        square = (around - foot[:, None]).square().sum(dim=2)
        square = square - square.min(dim=1, keepdim=True).values
        return torch.exp(-square / (2 * self._width**2))


def _plane(around: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted mean (n, 3) and axes (n, 3, 3) as columns, the normal first."""
    share = weights / weights.sum(dim=1, keepdim=True)
    centre = (share[:, :, None] * around).sum(dim=1)
    offset = around - centre[:, None]
    spread = torch.einsum("nk,nki,nkj->nij", share, offset, offset)
    return centre, torch.linalg.eigh(spread).eigenvectors


def _height(offset: Tensor, weights: Tensor, axes: Tensor) -> Tensor:
    """(n,) height at the origin of the weighted quadratic in two of the axes over the first."""
    height, u, v = torch.einsum("nki,nij->jnk", offset, axes)
    terms = torch.stack([torch.ones_like(u), u, v, u * u, u * v, v * v], dim=2)
    weighted = weights[:, :, None] * terms
    square = weighted.transpose(1, 2) @ terms
    size = square.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None]
    square += TINY * size * torch.eye(6, dtype=square.dtype)  # far samples determine little
    right = (weighted * height[:, :, None]).sum(dim=1)
    return torch.linalg.solve(square, right)[:, 0]


def main(cloud_path: str, mesh_path: str, resolution: str) -> None:
    """Reconstruct one cloud."""
    cloud = np.load(cloud_path, allow_pickle=False)
    frame = Normalisation.of(cloud)
    samples = torch.from_numpy(np.unique(frame.to_unit(cloud), axis=0))
    with torch.inference_mode():
        mesh = extract(MovingLeastSquares(samples), samples, ExtractConfig(int(resolution)))
    write_mesh(Mesh(frame.to_world(mesh.vertices), mesh.faces), Path(mesh_path))


if __name__ == "__main__":
    main(*sys.argv[1:4])
