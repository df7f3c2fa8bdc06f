"""Fits of local quadrics to the nearest samples: compiled on the CPU, as tensors elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from udflow.cloud.fit_loops import fit_chosen_rows, fit_rows
from udflow.cloud.neighbours import Neighbours, NeighbourTree
from udflow.cloud.quadrics import (
    FALLOFF,
    RIDGE,
    LocalQuadrics,
    feet_on_quadrics,
    joined,
    monomials,
    principal_frame,
)
from udflow.compiled import over_rows

_CHUNK = 1 << 15


@dataclass(frozen=True)
class Fits:
    """Quadrics fitted with one number of neighbours.

    Attributes:
        quadrics: n of them.
        variance: (n,) share of the samples' noise variance that is left in the height of each
            quadric at its site.
        foot: (n, 3) of each site on its quadric.
    """

    quadrics: LocalQuadrics
    variance: Tensor
    foot: Tensor


def fit_width(samples: Tensor, tree: NeighbourTree, origins: Tensor, k: int) -> Fits:
    """Fits a quadric to the k nearest samples of each origin.

    Args:
        samples: (m, 3) the data.
        tree: the tree of the samples.
        origins: (n, 3) where the quadrics are wanted, unit frame.
        k: neighbours to use.
    """
    parts = [fit_nearest(samples, part, tree.nearest(part, k), k) for part in origins.split(_CHUNK)]
    return Fits(
        joined([p.quadrics for p in parts]),
        torch.cat([p.variance for p in parts]),
        torch.cat([p.foot for p in parts]),
    )


def fit_nearest(
    samples: Tensor, origin: Tensor, near: Neighbours, k: int, rows: Tensor | None = None
) -> Fits:
    """Fits a quadric to the k nearest samples of each origin, which are known.

    Args:
        samples: (m, 3) the data.
        origin: (n, 3) where the quadrics are wanted.
        near: k neighbours or more; if there are fewer samples than k, all of them.
        k: neighbours to use.
        rows: (n,) where in `near` those of each origin are; in order unless told.
    """
    k = min(k, near.index.shape[1])
    if rows is None:
        rows = torch.arange(len(origin), device=origin.device)
    by = by_loop if samples.device.type == "cpu" else by_tensors
    return by(samples, origin, near, k, rows)


def by_loop(samples: Tensor, origin: Tensor, near: Neighbours, k: int, rows: Tensor) -> Fits:
    """See `fit_nearest`, on the CPU."""
    count = len(origin)
    origin = origin.contiguous()
    result = Fits(_empty(origin, near, k, rows), torch.empty(count), torch.empty(count, 3))
    quadrics = result.quadrics
    arrays = (quadrics.frame, quadrics.coefficients, quadrics.radius, quadrics.error,
              result.variance, result.foot)  # fmt: skip
    known = (samples.contiguous(), origin, rows, near.distance, near.index)
    over_rows(fit_rows, count, *(a.numpy() for a in known), k, *(a.numpy() for a in arrays))
    return result


def _empty(origin: Tensor, near: Neighbours, k: int, rows: Tensor) -> LocalQuadrics:
    count = len(origin)
    return LocalQuadrics(
        origin=origin,
        frame=torch.empty(count, 3, 3),
        coefficients=torch.empty(count, 6),
        radius=torch.empty(count),
        error=torch.empty(count),
        spacing=near.spacing[rows],
        count=torch.full((count,), k),
    )


def by_tensors(samples: Tensor, origin: Tensor, near: Neighbours, k: int, rows: Tensor) -> Fits:
    """The same on any device."""
    used = Neighbours(near.distance[rows, :k], near.index[rows, :k])
    quadrics, variance = fit_weighted(samples, used, origin, torch.ones_like(used.distance))
    return Fits(quadrics, variance, feet_on_quadrics(quadrics, origin))


def fit_chosen(samples: Tensor, near: Neighbours, origin: Tensor, chosen: Tensor) -> LocalQuadrics:
    """Fits quadrics to some of the neighbours of each origin.

    Args:
        samples: (m, 3) the data.
        near: k of each origin.
        origin: (n, 3) where the quadrics are wanted.
        chosen: (n, k) bool, the neighbours to fit to.
    """
    by = chosen_by_loop if samples.device.type == "cpu" else chosen_by_tensors
    return by(samples, near, origin, chosen)


def chosen_by_loop(
    samples: Tensor, near: Neighbours, origin: Tensor, chosen: Tensor
) -> LocalQuadrics:
    """See `fit_chosen`, on the CPU."""
    rows = torch.arange(len(origin))
    result = replace(_empty(origin, near, 0, rows), count=chosen.sum(dim=1))
    arrays = (result.frame, result.coefficients, result.radius, result.error)
    known = (samples, origin, near.distance, near.index, chosen)
    over_rows(
        fit_chosen_rows,
        len(origin),
        *(a.contiguous().numpy() for a in known),
        *(a.numpy() for a in arrays),
    )
    return result


def chosen_by_tensors(
    samples: Tensor, near: Neighbours, origin: Tensor, chosen: Tensor
) -> LocalQuadrics:
    """The same on any device."""
    counted = Neighbours(near.distance * chosen, near.index)
    return fit_weighted(samples, counted, origin, chosen.float())[0]


def fit_weighted(
    samples: Tensor, near: Neighbours, origin: Tensor, share: Tensor
) -> tuple[LocalQuadrics, Tensor]:
    """Quadrics fitted to neighbours with weights (n, k), and their variances, see `Fits`."""
    offsets = samples[near.index] - origin[:, None]
    radius = near.distance.amax(dim=1, keepdim=True).clamp_min(1e-9)
    weights = share * torch.exp(-FALLOFF * (near.distance / radius).square())
    frame = principal_frame(offsets, weights)
    local = torch.einsum("nkj,nij->nki", offsets / radius[..., None], frame)
    basis = monomials(local[..., 0], local[..., 1])
    normal_matrix = torch.einsum("nk,nki,nkj->nij", weights, basis, basis)
    ridge = torch.diag(torch.tensor(RIDGE, device=samples.device))
    normal_matrix = normal_matrix + ridge * weights.sum(dim=1)[:, None, None]
    inverse = torch.linalg.inv(normal_matrix)
    moments = torch.einsum("nk,nki,nk->ni", weights, basis, local[..., 2])
    coefficients = torch.einsum("nij,nj->ni", inverse, moments)
    # leave-one-out residual of the sample itself: r / (1 - H), with H its own influence
    influence = inverse[:, 0, 0].clamp(0, 0.999)
    error = (coefficients[:, 0].abs() / (1 - influence)) * radius[:, 0]
    # the height at the site is a weighted sum of the samples' heights
    heights = weights * torch.einsum("ni,nki->nk", inverse[:, 0], basis)
    spacing = near.spacing
    count = share.sum(dim=1).long()
    quadrics = LocalQuadrics(origin, frame, coefficients, radius[:, 0], error, spacing, count)
    return quadrics, heights.square().sum(dim=1)
