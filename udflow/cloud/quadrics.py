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
_FINE = 0.008  # of the reach: a held-back error not worth a wider neighbourhood
_PATCH = 2.0  # radii from its sample beyond which a quadric is not followed
_CHUNK = 1 << 16


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
        reach: (n,) how far from the sample, along the surface, the quadric may be trusted.
        count: (n,) int64 neighbours used.
    """

    origin: Tensor
    frame: Tensor
    coefficients: Tensor
    radius: Tensor
    error: Tensor
    reach: Tensor
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
    growing = (best_score > _FINE * best.reach).nonzero().squeeze(1)
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
        growing = growing[best_score[growing] > _FINE * best.reach[growing]]
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
    result = replace(like, origin=points)
    for k in like.count.unique().tolist():
        which = (like.count == k).nonzero().squeeze(1)
        _replace(result, which, _fit(samples, tree, points[which], int(k)))
    return replace(result, error=like.error, reach=like.reach)


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
    reach = 2.0 * neighbours.distance[:, min(6, neighbours.distance.shape[1] - 1)]
    count = torch.full_like(neighbours.index[:, 0], neighbours.index.shape[1])
    return LocalQuadrics(origin, frame, coefficients, radius[:, 0], error, reach, count)


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
    w = c0 + c1 * u + c2 * v + c3 * u * u + c4 * u * v + c5 * v * v
    foot = torch.stack([u, v, w], dim=1)
    return quadrics.origin + radius * torch.einsum("ni,nij->nj", foot, quadrics.frame)
