"""The surface that the samples describe: where the trajectories end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.pieces import on_one_piece
from udflow.cloud.quadric_surface import QuadricSurface
from udflow.cloud.sites import Sites
from udflow.cloud.twicing import nearer_to_sites
from udflow.cloud.widths import fit_quadrics


@dataclass(frozen=True)
class SampledSurface:
    """Samples, and quadrics fitted to them, unit frame.

    Attributes:
        samples: (m, 3) the data.
        tree: their tree.
        surface: the quadrics, each at one of the samples.
    """

    samples: Tensor
    tree: NeighbourTree
    surface: QuadricSurface

    @classmethod
    def of(cls, samples: Tensor, detail: float = 0.0) -> SampledSurface:
        """Fits quadrics to (m, 3) distinct samples.

        Args:
            samples: the data.
            detail: length below which nothing is asked for: of samples that lie closer, one is
                the site of a quadric. All of them are data.
        """
        tree = NeighbourTree(samples)
        origin = thinned(samples, detail) if detail > 0 else samples
        sites = Sites(samples if len(origin) == len(samples) else origin, samples, tree)
        quadrics = nearer_to_sites(on_one_piece(fit_quadrics(sites), sites), sites)
        if detail > 0:
            quadrics = replace(quadrics, spacing=quadrics.spacing.clamp_min(detail))
        return cls(samples, tree, QuadricSurface.of(quadrics))

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points on the quadrics."""
        return self.surface.project(points)

    @property
    def spacing(self) -> float:
        """Median distance between samples on the surface."""
        return float(self.surface.quadrics.spacing.median())

    @property
    def error(self) -> float:
        """Median held-back error of the quadrics: noise plus what the samples cannot resolve."""
        return float(self.surface.quadrics.error.median())


def thinned(points: Tensor, cell: float) -> Tensor:
    """The first of the (n, 3) points in every occupied cell of a lattice, in their order.

    Coordinates are less than 2^20 cells.
    """
    x, y, z = torch.floor(points / cell).long().unbind(dim=1)
    _, group = torch.unique((x << 42) + (y << 21) + z, return_inverse=True)
    first = torch.full((int(group.max()) + 1,), len(points), device=points.device)
    order = torch.arange(len(points), device=points.device)
    first = first.scatter_reduce(0, group, order, reduce="amin")
    return points[first.sort().values]
