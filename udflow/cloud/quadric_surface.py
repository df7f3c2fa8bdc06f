"""The surface that local quadrics make together: blended where smooth, joined at creases."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.cloud.creases import Candidates, feet_at_creases
from udflow.cloud.neighbours import Neighbours, NeighbourTree
from udflow.cloud.quadric_loops import project_rows
from udflow.cloud.quadrics import LocalQuadrics, feet_on_quadrics
from udflow.compiled import over_rows

_BLEND = 8  # quadrics that share in a foot
UNWIDENED = 16  # neighbours up to which a quadric was not widened against noise
_REACH = 1.7  # spacings from its site, along the surface, up to which a quadric is trusted
# Far away the foot lies among the nearest sites, but where the surface ends: there a foot farther
# out would be one beyond a rim or a crease.
_FAR_REACH = 0.3
_FROM = 3.0  # spacings from its site up to which a query is near it
_CHUNK = 1 << 15


@dataclass(frozen=True)
class QuadricSurface:
    """Quadrics and the tree of their origins, the sites. A `ProjectiveField` by itself: right at
    any distance, exact where samples are dense, and slower than a fitted field."""

    quadrics: LocalQuadrics
    tree: NeighbourTree

    @classmethod
    def of(cls, quadrics: LocalQuadrics) -> QuadricSurface:
        """The surface of some quadrics."""
        return cls(quadrics, NeighbourTree(quadrics.origin))

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points on the quadrics of their nearest sites."""
        if len(points) == 0:
            return points
        return torch.cat([self._project(chunk) for chunk in points.split(_CHUNK)])

    def sure_feet(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Feet of (n, 3) points; (n,) bool, whether most of the quadrics there were not widened
        against noise; and (n,) the spacing of the samples there."""
        if len(points) == 0:
            return points, points[:, 0] > 0, points[:, 0]
        quadrics = self.quadrics
        few, parts = quadrics.count <= UNWIDENED, []
        for chunk in points.split(_CHUNK):
            near = self.tree.nearest(chunk, _BLEND)
            clean = few[near.index].float().mean(dim=1) > 0.5
            parts.append((self._feet(chunk, near), clean, quadrics.spacing[near.index[:, 0]]))
        feet, clean, spacing = (torch.cat(part) for part in zip(*parts, strict=True))
        return feet, clean, spacing

    def _project(self, points: Tensor) -> Tensor:
        return self._feet(points, self.tree.nearest(points, _BLEND))

    def _feet(self, points: Tensor, near: Neighbours) -> Tensor:
        by = self.by_loop if points.device.type == "cpu" else self.by_tensors
        return by(points, near)

    def by_loop(self, points: Tensor, near: Neighbours) -> Tensor:
        """Feet of (n, 3) points on the CPU, given the sites near them."""
        quadrics = self.quadrics
        feet = torch.empty_like(points)
        arrays = (points, near.index, near.distance, quadrics.origin, quadrics.frame,
                  quadrics.coefficients, quadrics.radius, quadrics.spacing)  # fmt: skip
        ready = [array.contiguous().numpy() for array in arrays]
        limits = _REACH, _FAR_REACH, _FROM
        over_rows(project_rows, len(points), *ready, limits, feet.numpy())
        return feet

    def by_tensors(self, points: Tensor, near: Neighbours) -> Tensor:
        """The same on any device."""
        count = near.index.shape[1]
        quadrics = self.quadrics[near.index.reshape(-1)]
        feet = feet_on_quadrics(quadrics, points[:, None].expand(-1, count, -1).reshape(-1, 3))
        first, last = near.distance[:, :1], near.distance[:, -1:]
        candidates = Candidates(
            points=points,
            quadrics=near.index,
            feet=feet.view(-1, count, 3),
            origins=quadrics.origin.view(-1, count, 3),
            normals=quadrics.frame[:, 2].reshape(-1, count, 3),
            spacing=quadrics.spacing.view(-1, count)[:, 0],
            farness=(near.distance.square() - first.square()) / last.square().clamp_min(1e-18),
        )
        row = torch.arange(len(points), device=points.device)
        lead = candidates.leading(_REACH)
        foot = candidates.blended(candidates.feet[row, lead], torch.ones_like(near.distance))
        site, spacing = candidates.origins[row, lead], candidates.spacing
        creased = candidates.creased()
        if len(creased) > 0:
            foot[creased] = feet_at_creases(self.quadrics, candidates[creased])
            site[creased] = candidates.origins[creased, 0]
        nearness = (_FROM * spacing / first[:, 0].clamp_min(1e-18)).clamp_max(1.0)
        reach = _FAR_REACH + (_REACH - _FAR_REACH) * nearness.square()
        inside = _overshoot(foot, candidates.origins) <= _FAR_REACH * spacing
        reach = torch.where(inside, _REACH, reach)
        return site + _limited(foot - site, reach * spacing)


def _overshoot(feet: Tensor, sites: Tensor) -> Tensor:
    """(n,) how far feet (n, 3) lie beyond all of the sites (n, c, 3), along the direction to the
    centroid of these; negative where they lie among them."""
    offset = sites - feet[:, None]
    inwards = torch.nn.functional.normalize(offset.sum(dim=1), dim=1)
    return (offset * inwards[:, None]).sum(dim=2).amin(dim=1)


def _limited(offset: Tensor, limit: Tensor) -> Tensor:
    """Offsets (n, 3) shortened to at most `limit` (n,): quadrics end where their data end."""
    length = offset.norm(dim=1).clamp_min(1e-18)
    return offset * (limit / length).clamp_max(1.0)[:, None]
