"""Sheets as close as the samples on them: planes that samples share more exactly than by chance.

Where two sheets, or many creases, lie within a few spacings, all quadrics run through several of
them, none is right, and what they miss by looks like noise. But samples without noise lie exactly
on their surface. Of all planes through a site and two of its nearest samples, the one that most of
the neighbourhood shares to within a twentieth of a spacing is that of the site's own sheet (the
random sample consensus of Fischler and Bolles 1981, with every nearest sample asked). Under noise
no plane is shared by that many.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from udflow.cloud.consensus_loops import consensus_rows
from udflow.cloud.fits import fit_chosen
from udflow.cloud.neighbours import Neighbours
from udflow.cloud.quadrics import LocalQuadrics, copied, heights_over, put
from udflow.cloud.sites import Sites
from udflow.compiled import over_rows

_VOTERS, _VOTES = 16, 0.4  # sites around, and how many of them must have such planes as well


@dataclass(frozen=True)
class Asked:
    """What is asked of a plane.

    Attributes:
        pool: nearest samples that are asked.
        corners: nearest samples, the site with them, through which planes are laid.
        angle: sine at the site of the two others, at least.
        tolerance: spacings from a plane within which a sample shares it.
        share: of the neighbourhood that shares it.
        broad: breadth of what shares it, see `consensus_loops`; a scan line has 0.
        fewest, most: samples that a quadric is then fitted to.
        gain: times more it must explain than the quadric there was.
    """

    pool: int
    corners: int
    angle: float
    tolerance: float
    share: float
    broad: float
    fewest: int
    most: int
    gain: float


# a third sheet may lie near: a third of the neighbourhood is enough
SHEETS = Asked(pool=32, corners=10, angle=0.3, tolerance=0.05, share=0.3, broad=0.097, fewest=8,
               most=16, gain=2.0)  # fmt: skip


@dataclass(frozen=True)
class Shared:
    """The planes that most of n neighbourhoods share.

    Attributes:
        agreed: (n,) bool, whether there is a plane that enough samples share.
        better: (n,) bool, whether it explains more than the quadric there is.
        piece: (n, k) bool, the nearest samples on it.
        error: (n,) their root mean square distance from it.
    """

    agreed: Tensor
    better: Tensor
    piece: Tensor
    error: Tensor


def on_shared_planes(quadrics: LocalQuadrics, sites: Sites) -> tuple[LocalQuadrics, Tensor]:
    """Quadrics (n) fitted again to the samples on a shared plane, where these are better explained
    by it, and (n,) bool, which these are.

    Args:
        quadrics: fitted to all the nearest samples, one at each site.
        sites: the same.
    """
    shared = shared_planes(quadrics, sites.samples, sites.near, SHEETS)
    better = shared.better & (sites.mean(shared.agreed.float(), _VOTERS) > _VOTES)
    which = better.nonzero().squeeze(1)
    if len(which) == 0:
        return quadrics, better
    fitted = fitted_to(shared, quadrics, sites.samples, sites.near, which)
    result = copied(quadrics)
    put(result, which, replace(fitted, error=shared.error[which]))
    return result, better


def shared_planes(
    quadrics: LocalQuadrics, samples: Tensor, near: Neighbours, asked: Asked
) -> Shared:
    """Of all planes through each of n sites and two of its nearest samples the one that most of
    the neighbourhood shares.

    Args:
        quadrics: n of them, at the sites.
        samples: (m, 3) the data.
        near: the nearest samples of the sites.
        asked: what is asked of the planes.
    """
    by = by_loop if samples.device.type == "cpu" else by_tensors
    return by(quadrics, samples, near, asked)


def fitted_to(
    shared: Shared, quadrics: LocalQuadrics, samples: Tensor, near: Neighbours, which: Tensor
) -> LocalQuadrics:
    """Some of n quadrics, fitted again to the samples on the planes they share."""
    pool = shared.piece.shape[1]
    chosen = Neighbours(near.distance[which, :pool], near.index[which, :pool])
    fitted = fit_chosen(samples, chosen, quadrics.origin[which], shared.piece[which])
    return replace(fitted, error=quadrics.error[which], spacing=quadrics.spacing[which])


def _tolerance(quadrics: LocalQuadrics, asked: Asked) -> Tensor:
    return (asked.tolerance * quadrics.spacing).clamp_min(1e-9)


def by_loop(quadrics: LocalQuadrics, samples: Tensor, near: Neighbours, asked: Asked) -> Shared:
    """See `shared_planes`, on the CPU."""
    count, pool = len(quadrics.origin), min(asked.pool, near.index.shape[1])
    result = Shared(
        agreed=torch.empty(count, dtype=torch.bool),
        better=torch.empty(count, dtype=torch.bool),
        piece=torch.empty(count, pool, dtype=torch.bool),
        error=torch.empty(count),
    )
    limits = (asked.corners, asked.fewest, asked.most, asked.angle, asked.share, asked.broad,
              asked.gain)  # fmt: skip
    known = (samples, quadrics.origin, quadrics.frame, quadrics.coefficients, quadrics.radius,
             _tolerance(quadrics, asked), near.distance, near.index)  # fmt: skip
    found = (result.agreed, result.better, result.piece, result.error)
    over_rows(consensus_rows, count, *(a.contiguous().numpy() for a in known), limits,
              *(a.numpy() for a in found))  # fmt: skip
    return result


def by_tensors(quadrics: LocalQuadrics, samples: Tensor, near: Neighbours, asked: Asked) -> Shared:
    """The same on any device."""
    near = Neighbours(near.distance[:, : asked.pool], near.index[:, : asked.pool])
    offset = samples[near.index] - quadrics.origin[:, None]
    weights = torch.exp(-(near.distance / near.distance[:, -1:].clamp_min(1e-12)).square())
    limit = _tolerance(quadrics, asked)[:, None]
    best, normal = torch.zeros_like(quadrics.radius), torch.zeros_like(quadrics.origin)
    last = min(asked.corners, offset.shape[1])
    for one, two in ((i, j) for i in range(1, last) for j in range(i + 1, last)):
        across = torch.linalg.cross(offset[:, one], offset[:, two])
        length = across.norm(dim=1)
        broad = length > asked.angle * near.distance[:, one] * near.distance[:, two]
        across = across / length.clamp_min(1e-30)[:, None]
        score = _score((offset * across[:, None]).sum(dim=2) / limit, weights)
        taken = broad & (score > best)
        best = torch.where(taken, score, best)
        normal = torch.where(taken[:, None], across, normal)
    off = (offset * normal[:, None]).sum(dim=2)
    piece = off.abs() < limit
    piece &= piece.cumsum(dim=1) <= asked.most
    count = piece.sum(dim=1)
    error = ((off * piece).square().sum(dim=1) / count.clamp_min(1)).sqrt()
    enough = (best > asked.share * weights.sum(dim=1)) & (count >= asked.fewest)
    agreed = enough & (_breadth(offset, piece) > asked.broad)
    heights = heights_over(quadrics, samples[near.index]) / limit
    better = agreed & (best > asked.gain * _score(heights, weights))
    return Shared(agreed, better, piece, error)


def _score(off: Tensor, weights: Tensor) -> Tensor:
    """(n,) how much of neighbourhoods lies near, given distances (n, k) in tolerances."""
    return ((1 - off.square()).clamp_min(0) * weights).sum(dim=1)


def _breadth(offset: Tensor, piece: Tensor) -> Tensor:
    """(n,) how broad the chosen offsets (n, k, 3) lie, see `consensus_loops`."""
    chosen = (offset * piece[..., None]).double()
    spread = torch.einsum("nki,nkj->nij", chosen, chosen)
    total = spread.diagonal(dim1=1, dim2=2).sum(dim=1).square()
    return 0.5 * (total - spread.square().sum(dim=(1, 2))) / total.clamp_min(np.finfo(float).tiny)
