"""Local quadrics: the surface near each sample as a height function, fitted to its neighbours.

They are the teacher of the trajectories: the foot of a query is its nearest point on the blended
quadrics of the nearest samples instead of the nearest sample itself. Point-to-surface targets are
what the paper's densification tends to; with quadrics they are there from the start, and without
the curvature bias of tangent planes. Normals are unsigned and of no consequence.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from udflow.cloud.neighbours import Neighbours, NeighbourTree

NEIGHBOUR_COUNTS = (10, 16, 24, 40, 64, 96)  # widths tried for each sample
_SCORE_NEIGHBOURS = 48  # samples over which held-back errors are averaged
_FALLOFF = 2.0  # weight exp(-falloff (distance / radius)^2)
_FINE = 0.02  # of the spacing: a held-back error not worth a wider neighbourhood
_PATCH = 2.0  # radii from its sample beyond which a quadric is not followed
_BLEND = 6  # quadrics that share in a foot
_DISSENT = 0.65  # spacings by which a foot may differ from that on the nearest quadric
_REACH = 1.7  # spacings from its site, along the surface, up to which a quadric is trusted
_CHUNK = 1 << 15


@dataclass(frozen=True)
class LocalQuadrics:
    """One quadric per sample, in a frame centred on the sample.

    In the frame, with lengths divided by `radius`, the surface is
    w = c0 + c1 u + c2 v + c3 u^2 + c4 u v + c5 v^2.

    Attributes:
        origin: (n, 3) the samples, unit frame.
        frame: (n, 3, 3) rows u, v, w; w is the unsigned normal.
        coefficients: (n, 6) c0..c5.
        radius: (n,) distance of the farthest neighbour used.
        error: (n,) held-back prediction error, a length: how far a sample lies from the quadric
            fitted to its neighbours alone, root mean square over the neighbourhood.
        spacing: (n,) distance between samples on the surface around the site.
        count: (n,) int64 neighbours used.
    """

    origin: Tensor
    frame: Tensor
    coefficients: Tensor
    radius: Tensor
    error: Tensor
    spacing: Tensor
    count: Tensor

    def __getitem__(self, index: Tensor) -> LocalQuadrics:
        """The quadrics of some samples."""
        return LocalQuadrics(*(getattr(self, f.name)[index] for f in fields(self)))


def fit_quadrics(sites: Tensor, samples: Tensor, tree: NeighbourTree) -> LocalQuadrics:
    """Fits a quadric at every site, each with the width that predicts held-back samples best.

    Widths are tried from narrow to wide; a site goes on to a wider one only while its
    neighbourhood's held-back error falls and is worth lowering, so clean data stay sharp and
    noisy data are averaged.

    Args:
        sites: (n, 3) some of the samples, unit frame.
        samples: (m, 3) distinct points, the data.
        tree: the tree of the samples.
    """
    counts = [k for k in NEIGHBOUR_COUNTS if k <= tree.size] or [tree.size]
    score_neighbours = NeighbourTree(sites).nearest(sites, _SCORE_NEIGHBOURS)
    best = _fit(samples, tree, sites, counts[0])
    best_score = _smoothed(best.error, score_neighbours)
    growing = (best_score > _FINE * best.spacing).nonzero().squeeze(1)
    for k in counts[1:]:
        if len(growing) == 0:
            break
        wider = _fit(samples, tree, sites[growing], k)
        error = best.error.clone()
        error[growing] = wider.error
        score = _smoothed(error, score_neighbours)
        better = score[growing] < best_score[growing]
        growing = growing[better]
        _replace(best, growing, wider[better])
        best_score[growing] = score[growing]
        growing = growing[best_score[growing] > _FINE * best.spacing[growing]]
    return replace(best, error=best_score)


def quadrics_between(
    points: Tensor, samples: Tensor, tree: NeighbourTree, like: LocalQuadrics
) -> LocalQuadrics:
    """Quadrics at points between the samples, as wide as given ones.

    Args:
        points: (n, 3) origins of the new quadrics, unit frame.
        samples: (m, 3) the data that they are fitted to.
        tree: the tree of the samples.
        like: n quadrics that were fitted nearby.
    """
    result = LocalQuadrics(*(torch.empty_like(getattr(like, f.name)) for f in fields(like)))
    for k in like.count.unique().tolist():
        which = (like.count == k).nonzero().squeeze(1)
        _replace(result, which, _fit(samples, tree, points[which], int(k)))
    return replace(result, error=like.error, spacing=like.spacing)


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
        """Feet of (n, 3) points on the blended quadrics of their nearest sites."""
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
        nearest = self.quadrics.origin[near.index[:, 0]]
        spacing = self.quadrics.spacing[near.index[:, 0]]

        first, last = near.distance[:, :1], near.distance[:, -1:]
        closeness = (near.distance.square() - first.square()) / last.square().clamp_min(1e-18)
        # quadrics of another sheet or of the far side of a crease must not pull the foot
        dissent = (feet - feet[:, :1]).norm(dim=2) / (_DISSENT * spacing[:, None])
        weights = torch.exp(-4 * closeness - dissent.square())
        foot = (weights[..., None] * feet).sum(dim=1) / weights.sum(dim=1, keepdim=True)
        return nearest + _limited(foot - nearest, _REACH * spacing)


def _limited(offset: Tensor, limit: Tensor) -> Tensor:
    """Offsets (n, 3) shortened to at most `limit` (n,): quadrics end where their data end."""
    length = offset.norm(dim=1).clamp_min(1e-18)
    return offset * (limit / length).clamp_max(1.0)[:, None]


def joined(parts: list[LocalQuadrics]) -> LocalQuadrics:
    """Quadrics one after the other."""
    return LocalQuadrics(
        *(torch.cat([getattr(p, f.name) for p in parts]) for f in fields(LocalQuadrics))
    )


def _replace(target: LocalQuadrics, which: Tensor, values: LocalQuadrics) -> None:
    for f in fields(LocalQuadrics):
        getattr(target, f.name)[which] = getattr(values, f.name)


def _smoothed(error: Tensor, neighbours: Neighbours) -> Tensor:
    """Root of the mean squared error over the neighbourhood, (n,)."""
    return error.square()[neighbours.index].mean(dim=1).sqrt()


def _fit(samples: Tensor, tree: NeighbourTree, origins: Tensor, k: int) -> LocalQuadrics:
    return joined(
        [_fit_chunk(samples, tree.nearest(part, k), part) for part in origins.split(_CHUNK)]
    )


def _fit_chunk(samples: Tensor, neighbours: Neighbours, origin: Tensor) -> LocalQuadrics:
    offsets = samples[neighbours.index] - origin[:, None]
    radius = neighbours.distance[:, -1:].clamp_min(1e-9)
    weights = torch.exp(-_FALLOFF * (neighbours.distance / radius).square())
    frame = principal_frame(offsets, weights)
    local = torch.einsum("nkj,nij->nki", offsets / radius[..., None], frame)
    basis = _monomials(local[..., 0], local[..., 1])
    normal_matrix = torch.einsum("nk,nki,nkj->nij", weights, basis, basis)
    total = weights.sum(dim=1)
    # a breath of regularisation keeps collinear neighbourhoods solvable and flat ones flat
    ridge = torch.tensor([1e-6, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3], device=samples.device)
    normal_matrix = normal_matrix + torch.diag(ridge) * total[:, None, None]
    inverse = torch.linalg.inv(normal_matrix)
    moments = torch.einsum("nk,nki,nk->ni", weights, basis, local[..., 2])
    coefficients = torch.einsum("nij,nj->ni", inverse, moments)
    # leave-one-out residual of the sample itself: r / (1 - H), with H its own influence
    influence = inverse[:, 0, 0].clamp(0, 0.999)
    error = (coefficients[:, 0].abs() / (1 - influence)) * radius[:, 0]
    # one sample per a^2 puts the sixth neighbour at about 1.3 a
    spacing = neighbours.distance[:, min(6, neighbours.distance.shape[1] - 1)] / 1.3
    count = torch.full_like(neighbours.index[:, 0], neighbours.index.shape[1])
    return LocalQuadrics(origin, frame, coefficients, radius[:, 0], error, spacing, count)


def principal_frame(offsets: Tensor, weights: Tensor) -> Tensor:
    """Principal axes of weighted (n, k, 3) offsets: (n, 3, 3) rows from wide to narrow."""
    mean = (weights[..., None] * offsets).sum(dim=1) / weights.sum(dim=1, keepdim=True)
    centred = offsets - mean[:, None]
    covariance = torch.einsum("nk,nki,nkj->nij", weights, centred, centred)
    # scaled, so that tiny neighbourhoods do not underflow in single precision
    scale = covariance.diagonal(dim1=1, dim2=2).sum(dim=1).clamp_min(1e-30)
    _, vectors = torch.linalg.eigh(covariance / scale[:, None, None])
    return vectors.flip(dims=(2,)).transpose(1, 2)


def _monomials(u: Tensor, v: Tensor) -> Tensor:
    return torch.stack([torch.ones_like(u), u, v, u * u, u * v, v * v], dim=-1)


def feet_on_quadrics(quadrics: LocalQuadrics, queries: Tensor, newton_steps: int = 2) -> Tensor:
    """The nearest point on quadric i of query i, by Newton steps in the frame.

    From far away a step may overshoot along a curved patch: of the foot, the point half-way to
    the origin and that above the origin, the nearest is taken.

    Args:
        quadrics: n quadrics.
        queries: (n, 3).

    Returns:
        (n, 3).
    """
    radius = quadrics.radius[:, None]
    local = torch.einsum("nj,nij->ni", (queries - quadrics.origin) / radius, quadrics.frame)
    u, v = local[:, 0], local[:, 1]
    c0, c1, c2, c3, c4, c5 = quadrics.coefficients.unbind(dim=1)
    for _ in range(newton_steps):
        slope_u = c1 + 2 * c3 * u + c4 * v
        slope_v = c2 + c4 * u + 2 * c5 * v
        above = local[:, 2] - (c0 + c1 * u + c2 * v + c3 * u * u + c4 * u * v + c5 * v * v)
        gradient_u = (u - local[:, 0]) - above * slope_u
        gradient_v = (v - local[:, 1]) - above * slope_v
        # full Hessian where it is safely positive, Gauss-Newton beyond the focal distance
        uu, uv, vv = 1 + slope_u**2, slope_u * slope_v, 1 + slope_v**2
        full_uu, full_uv, full_vv = uu - 2 * above * c3, uv - above * c4, vv - 2 * above * c5
        safe = (full_uu > 0.2) & (full_uu * full_vv - full_uv**2 > 0.2)
        uu, uv, vv = (
            torch.where(safe, full, plain)
            for full, plain in ((full_uu, uu), (full_uv, uv), (full_vv, vv))
        )
        determinant = uu * vv - uv * uv
        u = u - (vv * gradient_u - uv * gradient_v) / determinant
        v = v - (uu * gradient_v - uv * gradient_u) / determinant
        u, v = u.clamp(-_PATCH, _PATCH), v.clamp(-_PATCH, _PATCH)
    best = _lifted(quadrics.coefficients, u, v)
    for share in (0.5, 0.0):
        nearer = _lifted(quadrics.coefficients, share * u, share * v)
        improves = (nearer - local).norm(dim=1) < (best - local).norm(dim=1)
        best = torch.where(improves[:, None], nearer, best)
    return quadrics.origin + radius * torch.einsum("ni,nij->nj", best, quadrics.frame)


def _lifted(coefficients: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Points of quadrics over (n,) u and v, in their frames, (n, 3)."""
    height = (coefficients * _monomials(u, v)).sum(dim=1)
    return torch.stack([u, v, height], dim=1)
