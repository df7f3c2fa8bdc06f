"""The surface that the samples describe: where the trajectories end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadrics import (
    LocalQuadrics,
    feet_on_quadrics,
    fit_quadrics,
    joined,
    quadrics_between,
)

_BLEND = 6  # quadrics that share in a foot
_CHUNK = 1 << 15


@dataclass(frozen=True)
class SampledSurface:
    """Samples, and quadrics fitted to them at some sites, unit frame.

    It is a `ProjectiveField` by itself: exact where samples are dense, undefined between them
    where they are not, and slower than a fitted field.

    Attributes:
        samples: (m, 3) the data.
        sample_tree: their tree.
        quadrics: n quadrics; their origins are the sites.
        site_tree: the tree of the sites.
    """

    samples: Tensor
    sample_tree: NeighbourTree
    quadrics: LocalQuadrics
    site_tree: NeighbourTree

    @classmethod
    def of(cls, samples: Tensor, detail: float = 0.0) -> SampledSurface:
        """Fits quadrics to (m, 3) distinct samples.

        Args:
            samples: the data.
            detail: length below which nothing is asked for: of samples that lie closer, one is
                the site of a quadric. All of them are data.
        """
        tree = NeighbourTree(samples)
        sites = thinned(samples, detail) if detail > 0 else samples
        quadrics = fit_quadrics(sites, samples, tree)
        if detail > 0:
            quadrics = replace(quadrics, reach=quadrics.reach.clamp_min(2 * detail))
        return cls(samples, tree, quadrics, NeighbourTree(sites))

    def densified(self, points: Tensor) -> SampledSurface:
        """The surface with quadrics at (k, 3) further points near it, fitted to the same data."""
        nearest = self.quadrics[self.site_tree.nearest(points, 1).index[:, 0]]
        between = quadrics_between(points, self.samples, self.sample_tree, nearest)
        quadrics = joined([self.quadrics, between])
        return replace(self, quadrics=quadrics, site_tree=NeighbourTree(quadrics.origin))

    @property
    def sites(self) -> Tensor:
        """(n, 3) origins of the quadrics."""
        return self.quadrics.origin

    @property
    def spacings(self) -> Tensor:
        """(n,) distance between samples on the surface around each site, unit frame."""
        # the reach is twice the distance of the sixth neighbour, which in a random sample of a
        # surface with one point per a^2 lies at about 1.3 a
        return self.quadrics.reach / 2.6

    @property
    def spacing(self) -> float:
        """Median of the spacings."""
        return float(self.spacings.median())

    @property
    def error(self) -> float:
        """Median held-back error of the quadrics: noise plus what the samples cannot resolve."""
        return float(self.quadrics.error.median())

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points on the blended quadrics of their nearest samples."""
        if len(points) == 0:
            return points
        return torch.cat([self._project(chunk) for chunk in points.split(_CHUNK)])

    def _project(self, points: Tensor) -> Tensor:
        near = self.site_tree.nearest(points, _BLEND)
        count = near.index.shape[1]
        feet = feet_on_quadrics(
            self.quadrics[near.index.reshape(-1)],
            points[:, None].expand(-1, count, -1).reshape(-1, 3),
        ).view(-1, count, 3)
        nearest = self.sites[near.index[:, 0]]
        reach = self.quadrics.reach[near.index[:, 0]]

        first, last = near.distance[:, :1], near.distance[:, -1:]
        closeness = (near.distance.square() - first.square()) / last.square().clamp_min(1e-18)
        # quadrics of another sheet or of the far side of a crease must not pull the foot
        dissent = (feet - feet[:, :1]).norm(dim=2) / (0.25 * reach[:, None])
        weights = torch.exp(-4 * closeness - dissent.square())
        foot = (weights[..., None] * feet).sum(dim=1) / weights.sum(dim=1, keepdim=True)
        return nearest + _limited(foot - nearest, reach)


def thinned(points: Tensor, cell: float) -> Tensor:
    """The first of the (n, 3) points in every occupied cell of a lattice, in their order."""
    keys = torch.floor(points / cell).long()
    _, group = torch.unique(keys, dim=0, return_inverse=True)
    first = torch.full((int(group.max()) + 1,), len(points), device=points.device)
    order = torch.arange(len(points), device=points.device)
    first = first.scatter_reduce(0, group, order, reduce="amin")
    return points[first.sort().values]


def _limited(offset: Tensor, limit: Tensor) -> Tensor:
    """Offsets (n, 3) shortened to at most `limit` (n,): quadrics end where their data end."""
    length = offset.norm(dim=1).clamp_min(1e-18)
    return offset * (limit / length).clamp_max(1.0)[:, None]
