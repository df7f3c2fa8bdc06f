"""The surface that the samples describe: where the trajectories end."""

from __future__ import annotations

from dataclasses import dataclass

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
    """Samples, their tree and their quadrics, unit frame.

    It is a `ProjectiveField` by itself: exact where samples are dense, undefined between them
    where they are not, and slower than a fitted field.
    """

    samples: Tensor
    tree: NeighbourTree
    quadrics: LocalQuadrics

    @classmethod
    def of(cls, samples: Tensor) -> SampledSurface:
        """Fits the quadrics of (n, 3) distinct samples."""
        tree = NeighbourTree(samples)
        return cls(samples, tree, fit_quadrics(samples, tree))

    def densified(self, points: Tensor) -> SampledSurface:
        """The surface with quadrics at (m, 3) further points, fitted to the same data.

        Args:
            points: near the surface, between the samples of this surface, which must be the
                measured ones.
        """
        between = quadrics_between(points, self.samples, self.tree, self.quadrics)
        samples = torch.cat([self.samples, points])
        return SampledSurface(samples, NeighbourTree(samples), joined([self.quadrics, between]))

    @property
    def spacings(self) -> Tensor:
        """(n,) distance between samples on the surface around each, unit frame."""
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
        near = self.tree.nearest(points, _BLEND)
        count = near.index.shape[1]
        feet = feet_on_quadrics(
            self.quadrics[near.index.reshape(-1)],
            points[:, None].expand(-1, count, -1).reshape(-1, 3),
        ).view(-1, count, 3)
        nearest = self.samples[near.index[:, 0]]
        reach = self.quadrics.reach[near.index[:, 0]]

        first, last = near.distance[:, :1], near.distance[:, -1:]
        closeness = (near.distance.square() - first.square()) / last.square().clamp_min(1e-18)
        # quadrics of another sheet or of the far side of a crease must not pull the foot
        dissent = (feet - feet[:, :1]).norm(dim=2) / (0.25 * reach[:, None])
        weights = torch.exp(-4 * closeness - dissent.square())
        foot = (weights[..., None] * feet).sum(dim=1) / weights.sum(dim=1, keepdim=True)
        return nearest + _limited(foot - nearest, reach)


def _limited(offset: Tensor, limit: Tensor) -> Tensor:
    """Offsets (n, 3) shortened to at most `limit` (n,): quadrics end where their data end."""
    length = offset.norm(dim=1).clamp_min(1e-18)
    return offset * (limit / length).clamp_max(1.0)[:, None]
