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

FALLOFF = 2.0  # weight exp(-falloff (distance / radius)^2)
PATCH = 2.0  # radii from its sample beyond which a quadric is not followed
# A breath of regularisation keeps collinear neighbourhoods solvable and flat ones flat.
RIDGE = (1e-6, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3)
NEWTON_STEPS = 2  # to the foot


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


def joined(parts: list[LocalQuadrics]) -> LocalQuadrics:
    """Quadrics one after the other."""
    return LocalQuadrics(
        *(torch.cat([getattr(p, f.name) for p in parts]) for f in fields(LocalQuadrics))
    )


def copied(quadrics: LocalQuadrics) -> LocalQuadrics:
    """The same in tensors of their own."""
    return LocalQuadrics(*(getattr(quadrics, f.name).clone() for f in fields(LocalQuadrics)))


def put(target: LocalQuadrics, which: Tensor, values: LocalQuadrics) -> None:
    """Replaces some of the quadrics, in place."""
    for f in fields(LocalQuadrics):
        getattr(target, f.name)[which] = getattr(values, f.name)


def moved(quadrics: LocalQuadrics, origin: Tensor) -> LocalQuadrics:
    """The same n surfaces, described from other origins (n, 3)."""
    offset = (origin - quadrics.origin) / quadrics.radius[:, None]
    u, v, w = torch.einsum("nj,nij->ni", offset, quadrics.frame).unbind(dim=1)
    _, c1, c2, c3, c4, c5 = quadrics.coefficients.unbind(dim=1)
    height = (quadrics.coefficients * monomials(u, v)).sum(dim=1) - w
    slope_u, slope_v = c1 + 2 * c3 * u + c4 * v, c2 + c4 * u + 2 * c5 * v
    coefficients = torch.stack([height, slope_u, slope_v, c3, c4, c5], dim=1)
    return replace(quadrics, origin=origin, coefficients=coefficients)


def principal_frame(offsets: Tensor, weights: Tensor) -> Tensor:
    """Principal axes of weighted (n, k, 3) offsets: (n, 3, 3) rows from wide to narrow."""
    mean = (weights[..., None] * offsets).sum(dim=1) / weights.sum(dim=1, keepdim=True)
    centred = offsets - mean[:, None]
    covariance = torch.einsum("nk,nki,nkj->nij", weights, centred, centred)
    # scaled, so that tiny neighbourhoods do not underflow in single precision
    scale = covariance.diagonal(dim1=1, dim2=2).sum(dim=1).clamp_min(1e-30)
    _, vectors = torch.linalg.eigh(covariance / scale[:, None, None])
    return vectors.flip(dims=(2,)).transpose(1, 2).contiguous()


def monomials(u: Tensor, v: Tensor) -> Tensor:
    """What the coefficients of quadrics multiply, (..., 6), of u and v."""
    return torch.stack([torch.ones_like(u), u, v, u * u, u * v, v * v], dim=-1)


def heights_over(quadrics: LocalQuadrics, points: Tensor) -> Tensor:
    """Heights (n, k) of k points each (n, k, 3) over n quadrics, along the quadrics' own w."""
    offset = (points - quadrics.origin[:, None]) / quadrics.radius[:, None, None]
    local = torch.einsum("nkj,nij->nki", offset, quadrics.frame)
    surface = monomials(local[..., 0], local[..., 1]) * quadrics.coefficients[:, None]
    return (local[..., 2] - surface.sum(dim=-1)) * quadrics.radius[:, None]


def normals_at(quadrics: LocalQuadrics, points: Tensor) -> Tensor:
    """Unit normals (n, 3) of n quadrics above or below the points (n, 3)."""
    offset = (points - quadrics.origin) / quadrics.radius[:, None]
    u, v = torch.einsum("nj,nij->ni", offset, quadrics.frame)[:, :2].unbind(dim=1)
    _, c1, c2, c3, c4, c5 = quadrics.coefficients.unbind(dim=1)
    slope_u, slope_v = c1 + 2 * c3 * u + c4 * v, c2 + c4 * u + 2 * c5 * v
    local = torch.stack([-slope_u, -slope_v, torch.ones_like(u)], dim=1)
    normal = torch.einsum("ni,nij->nj", local, quadrics.frame)
    return normal / normal.norm(dim=1, keepdim=True)


def feet_on_quadrics(
    quadrics: LocalQuadrics, queries: Tensor, newton_steps: int = NEWTON_STEPS
) -> Tensor:
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
        u, v = u.clamp(-PATCH, PATCH), v.clamp(-PATCH, PATCH)
    best = _lifted(quadrics.coefficients, u, v)
    for share in (0.5, 0.0):
        nearer = _lifted(quadrics.coefficients, share * u, share * v)
        improves = (nearer - local).norm(dim=1) < (best - local).norm(dim=1)
        best = torch.where(improves[:, None], nearer, best)
    return quadrics.origin + radius * torch.einsum("ni,nij->nj", best, quadrics.frame)


def _lifted(coefficients: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Points of quadrics over (n,) u and v, in their frames, (n, 3)."""
    height = (coefficients * monomials(u, v)).sum(dim=1)
    return torch.stack([u, v, height], dim=1)
