"""Feet near creases, where the quadrics around a query belong to different pieces of surface.

Each piece ends where it meets the next: a foot on one quadric does not count if it lies beyond
another one, on the side where its own piece has no samples, or beyond the outermost samples of its
own. If no foot counts, the query is nearest to the crease itself, the intersection of two quadrics.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from udflow.cloud.quadrics import LocalQuadrics, feet_on_quadrics, heights_over, normals_at

TURNED = 0.9  # cosine of normals below which two quadrics are different pieces
DISSENT = 0.4  # spacings by which feet that are blended may differ
NEARER = 0.25  # spacings by which the foot on another sheet must be nearer than that on the first
OFF = 0.02  # spacings from a quadric within which a point is on it
SAME_PIECE = 0.2  # spacings from a quadric within which a site shows that its piece goes on there
ROUNDS = 4
LOCAL = 2.0  # spacings from its site up to which a quadric ends other pieces
WAY = 1.5  # spacings: where two quadrics meet farther from the foot on one, it is no crease
BEHIND = 0.7  # spacings
SURELY_ON = 0.4  # spacings beyond the outermost of its sites that a piece goes on
OVERSHOOT = 0.8  # spacings that it goes on where a sample of any piece lies near
ON_DATA = 1.0  # spacings that are near
NEAR = 4.0  # spacings from its site beyond which a query cannot tell pieces
PARALLEL = 1e-3  # squared sine of the angle of planes below which they do not meet


@dataclass(frozen=True)
class Candidates:
    """The c nearest quadrics of n queries, nearest site first, and the feet on them.

    Attributes:
        points: (n, 3) queries.
        quadrics: (n, c) int64 indices.
        feet: (n, c, 3).
        origins: (n, c, 3) their sites.
        normals: (n, c, 3) at the sites, unsigned.
        spacing: (n,) at the nearest site.
        farness: (n, c) squared distance of a site beyond that of the nearest, 0..1.
    """

    points: Tensor
    quadrics: Tensor
    feet: Tensor
    origins: Tensor
    normals: Tensor
    spacing: Tensor
    farness: Tensor

    def __getitem__(self, index: Tensor) -> Candidates:
        """The candidates of some queries."""
        return Candidates(*(getattr(self, f.name)[index] for f in fields(self)))

    def blended(self, lead: Tensor, allowed: Tensor) -> Tensor:
        """Feet (n, 3): means of those near a leading foot (n, 3), by closeness of their sites.

        Quadrics of another sheet or of the far side of a crease must not pull the foot.
        """
        dissent = (self.feet - lead[:, None]).norm(dim=2) / (DISSENT * self.spacing[:, None])
        weights = torch.exp(-4 * self.farness - dissent.square()) * allowed
        total = weights.sum(dim=1, keepdim=True).clamp_min(1e-12)
        return (weights[..., None] * self.feet).sum(dim=1) / total

    def leading(self, reach: float) -> Tensor:
        """(n,) int64, the candidate whose foot leads: the first, but where sheets lie close the
        nearest site may be on the farther one, and then the nearest foot within so many spacings
        of its own site."""
        spacing = self.spacing[:, None]
        way = (self.feet - self.points[:, None]).norm(dim=2)
        along = (self.feet - self.origins).norm(dim=2)
        nearer = (way < way[:, :1] - NEARER * spacing) & (along < reach * spacing)
        shortest = torch.where(nearer, way, torch.inf).argmin(dim=1)
        return torch.where(nearer.any(dim=1), shortest, 0)

    def nearest_among(self, allowed: Tensor) -> Tensor:
        """(n, 3) the nearest of the (n, c) allowed feet; the nearest site where none is."""
        way = (self.feet - self.points[:, None]).norm(dim=2)
        shortest = torch.where(allowed, way, torch.inf).argmin(dim=1)
        row = torch.arange(len(shortest), device=shortest.device)
        foot = self.feet[row, shortest]
        return torch.where(allowed.any(dim=1, keepdim=True), foot, self.origins[:, 0])

    def creased(self) -> Tensor:
        """Indices of the queries whose quadrics belong to different pieces."""
        agreement = (self.normals * self.normals[:, :1]).sum(dim=2).abs()
        near = (self.points - self.origins[:, 0]).norm(dim=1) < NEAR * self.spacing
        return (near & (agreement < TURNED).any(dim=1)).nonzero().squeeze(1)


def feet_at_creases(quadrics: LocalQuadrics, candidates: Candidates) -> Tensor:
    """Feet (n, 3) of queries near creases.

    Args:
        quadrics: of all sites.
        candidates: of the queries.
    """
    around = quadrics[candidates.quadrics.reshape(-1)]
    turned = _turned(around, candidates)
    beyond, height = _beyond(around, turned, candidates)
    distance = (candidates.feet - candidates.points[:, None]).norm(dim=2)
    # a foot far behind the nearest one is farther than the crease between them
    close = distance < distance.amin(dim=1, keepdim=True) + BEHIND * candidates.spacing[:, None]
    supported = _supported(candidates, turned)
    valid = ~beyond.any(dim=1) & close & supported
    lead = torch.where(valid, distance, torch.inf).argmin(dim=1)
    row = torch.arange(len(lead), device=lead.device)
    foot = candidates.blended(candidates.feet[row, lead], valid & ~turned[row, lead])

    none = (~valid.any(dim=1)).nonzero().squeeze(1)
    if len(none) == 0:
        return foot
    foot[none] = _where_two_meet(
        quadrics, candidates[none], beyond[none], height[none], supported[none]
    )
    return foot


def _where_two_meet(
    quadrics: LocalQuadrics,
    candidates: Candidates,
    beyond: Tensor,
    height: Tensor,
    supported: Tensor,
) -> Tensor:
    """Feet (n, 3) on both the nearest quadric and the one that ends it most; where these do not
    meet nearby, on the first quadric if its samples support that, else the nearest that are."""
    crossed = torch.where(beyond[:, :, 0], height[:, :, 0].abs(), -1.0).argmax(dim=1)
    row = torch.arange(len(crossed), device=crossed.device)
    one = quadrics[candidates.quadrics[:, 0]]
    two = quadrics[candidates.quadrics[row, crossed]]
    foot = _on_both(one, two, candidates.points, candidates.feet[:, 0])
    lone = candidates.blended(candidates.feet[:, 0], torch.ones_like(candidates.farness))
    astray = (foot - lone).norm(dim=1) > WAY * candidates.spacing
    lone = torch.where(supported[:, :1], lone, candidates.nearest_among(supported))
    return torch.where(astray[:, None], lone, foot)


def _supported(candidates: Candidates, turned: Tensor) -> Tensor:
    """(n, c) whether the samples of its own piece reach up to each foot, or nearly.

    A face does not go on in its plane beyond an edge. By how far a foot lies beyond its piece is
    measured as in `mesh.support`: along the direction to the centroid of the sites.

    Args:
        candidates: of n queries.
        turned: (n, k, j) which of their quadrics are different pieces.
    """
    offset = candidates.origins[:, None] - candidates.feet[:, :, None]
    spacing = candidates.spacing[:, None]
    inwards = torch.nn.functional.normalize((offset * ~turned[..., None]).sum(dim=2), dim=2)
    along = (offset * inwards[:, :, None]).sum(dim=3)
    overshoot = torch.where(turned, torch.inf, along).amin(dim=2) / spacing
    near = offset.norm(dim=3).amin(dim=2) / spacing < ON_DATA
    return (overshoot < SURELY_ON) | (near & (overshoot < OVERSHOOT))


def _turned(around: LocalQuadrics, candidates: Candidates) -> Tensor:
    """(n, k, j) whether quadrics k and j are different pieces: even with its curvature, neither
    leads to the normal of the other."""
    count = candidates.feet.shape[1]
    each = around[
        torch.arange(len(around.origin), device=around.origin.device).repeat_interleave(count)
    ]
    there = candidates.origins[:, None].expand(-1, count, -1, -1).reshape(-1, 3)
    led_to = normals_at(each, there).view(-1, count, count, 3)
    agreement = (led_to * candidates.normals[:, None]).sum(dim=3).abs()
    return torch.maximum(agreement, agreement.transpose(1, 2)) < TURNED


def _beyond(around: LocalQuadrics, turned: Tensor, candidates: Candidates) -> tuple[Tensor, Tensor]:
    """Whether foot j lies beyond quadric k, (n, k, j), and its height over it.

    Args:
        around: the n * c quadrics of the candidates.
        turned: (n, k, j) which of them are different pieces.
        candidates: of n queries.
    """
    count = candidates.feet.shape[1]
    points = torch.cat([candidates.feet, candidates.origins], dim=1)
    each = points[:, None].expand(-1, count, -1, -1).reshape(-1, 2 * count, 3)
    height = heights_over(around, each).view(-1, count, 2 * count)
    of_foot, of_site = height[..., :count], height[..., count:]
    spacing = candidates.spacing[:, None, None]
    # the side on which piece j lies: that of its sites, for its own may be on the crease itself
    on_piece = ((of_site.abs() < SAME_PIECE * spacing) & ~turned).transpose(1, 2).float()
    side = torch.where(of_site.abs() > OFF * spacing, of_site, torch.matmul(of_site, on_piece))
    off = (of_foot.abs() > OFF * spacing) & (side.abs() > OFF * spacing)
    apart = candidates.feet[:, None] - candidates.origins[:, :, None]
    local = apart.norm(dim=3) < LOCAL * spacing
    beyond = turned & (of_foot * side < 0) & off & local

    # a piece that has a site on the far side as well goes on there: a junction, not a crease
    clearly = (of_site.abs() > 2 * OFF * spacing).float() * torch.sign(of_site)
    ahead = torch.matmul((clearly > 0).float(), on_piece) > 0
    behind = torch.matmul((clearly < 0).float(), on_piece) > 0
    beyond &= ~torch.where(of_foot > 0, ahead, behind)
    return beyond, of_foot


def _on_both(one: LocalQuadrics, two: LocalQuadrics, points: Tensor, start: Tensor) -> Tensor:
    """The points (n, 3) on both of two quadrics near (n, 3) points, by tangent planes."""
    foot = start
    for _ in range(ROUNDS):
        on_one, on_two = feet_on_quadrics(one, foot), feet_on_quadrics(two, foot)
        foot = _on_planes(points, on_one, normals_at(one, on_one), on_two, normals_at(two, on_two))
    return foot


def _on_planes(points: Tensor, on_a: Tensor, a: Tensor, on_b: Tensor, b: Tensor) -> Tensor:
    """The nearest points (n, 3) on the lines where planes with normals a and b meet."""
    cosine = (a * b).sum(dim=1)
    over_a, over_b = ((points - on_a) * a).sum(dim=1), ((points - on_b) * b).sum(dim=1)
    scale = (1 - cosine.square()).clamp_min(PARALLEL)
    along_a, along_b = (over_a - cosine * over_b) / scale, (over_b - cosine * over_a) / scale
    return points - along_a[:, None] * a - along_b[:, None] * b
