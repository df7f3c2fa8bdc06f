"""Sheets as close as the samples on them: planes that samples share more exactly than by chance.

Where two sheets, or many creases, lie within a few spacings, all quadrics run through several of
them, none is right, and what they miss by looks like noise. But samples without noise lie exactly
on their surface. Of all planes through a site and two of its nearest samples, the one that most of
the neighbourhood shares to within a twentieth of a spacing is that of the site's own sheet (the
random sample consensus of Fischler and Bolles 1981, with every nearest sample asked). Under noise
no plane is shared by that many.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from udflow.cloud.consensus_loops import consensus_rows
from udflow.cloud.fits import fit_chosen
from udflow.cloud.neighbours import Neighbours
from udflow.cloud.quadrics import LocalQuadrics, copied, heights_over, put
from udflow.cloud.sites import Sites
from udflow.compiled import over_rows

_POOL = 32  # nearest samples that are asked
_CORNERS = 10  # nearest samples, the site with them, through which planes are laid
_ANGLE = 0.3  # sine at the site of the two others, at least
_TOLERANCE = 0.05  # spacings from a plane within which a sample shares it
_SHARE = 0.3  # of the neighbourhood that shares it: a third sheet may lie near
_BROAD = 0.097  # breadth of what shares it, see `consensus_loops`; a scan line has 0
_FEWEST, _MOST = 8, 16  # samples that a quadric is then fitted to
_GAIN = 2.0  # times more it must explain than the quadric there was
_VOTERS, _VOTES = 16, 0.4  # sites around, and how many of them must have such planes as well


def on_shared_planes(quadrics: LocalQuadrics, sites: Sites) -> tuple[LocalQuadrics, Tensor]:
    """Quadrics (n) fitted again to the samples on a shared plane, where these are better explained
    by it, and (n,) bool, which these are.

    Args:
        quadrics: fitted to all the nearest samples, one at each site.
        sites: the same.
    """
    tolerance = (_TOLERANCE * quadrics.spacing).clamp_min(1e-9)
    by = by_loop if tolerance.device.type == "cpu" else by_tensors
    agreed, better, piece, error = by(quadrics, sites, tolerance)
    better = better & (sites.mean(agreed.float(), _VOTERS) > _VOTES)
    which = better.nonzero().squeeze(1)
    if len(which) == 0:
        return quadrics, better
    near, pool = sites.near, piece.shape[1]
    chosen = Neighbours(near.distance[which, :pool], near.index[which, :pool])
    fitted = fit_chosen(sites.samples, chosen, quadrics.origin[which], piece[which])
    result = copied(quadrics)
    put(result, which, replace(fitted, error=error[which], spacing=quadrics.spacing[which]))
    return result, better


def by_loop(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor) -> tuple[Tensor, ...]:
    """See `consensus_rows`: agreed, better, piece and error, on the CPU."""
    near, count = sites.near, len(tolerance)
    pool = min(_POOL, near.index.shape[1])
    agreed, better = torch.empty(count, dtype=torch.bool), torch.empty(count, dtype=torch.bool)
    piece, error = torch.empty(count, pool, dtype=torch.bool), torch.empty(count)
    limits = (_CORNERS, _FEWEST, _MOST, _ANGLE, _SHARE, _BROAD, _GAIN)
    known = (sites.samples, quadrics.origin, quadrics.frame, quadrics.coefficients,
             quadrics.radius, tolerance, near.distance, near.index)  # fmt: skip
    found = (agreed, better, piece, error)
    over_rows(consensus_rows, count, *(a.contiguous().numpy() for a in known), limits,
              *(a.numpy() for a in found))  # fmt: skip
    return found


def by_tensors(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor) -> tuple[Tensor, ...]:
    """The same on any device."""
    near = Neighbours(sites.near.distance[:, :_POOL], sites.near.index[:, :_POOL])
    offset = sites.samples[near.index] - quadrics.origin[:, None]
    weights = torch.exp(-(near.distance / near.distance[:, -1:].clamp_min(1e-12)).square())
    limit = tolerance[:, None]
    best, normal = torch.zeros_like(tolerance), torch.zeros_like(quadrics.origin)
    last = min(_CORNERS, offset.shape[1])
    for one, two in ((i, j) for i in range(1, last) for j in range(i + 1, last)):
        across = torch.linalg.cross(offset[:, one], offset[:, two])
        length = across.norm(dim=1)
        broad = length > _ANGLE * near.distance[:, one] * near.distance[:, two]
        across = across / length.clamp_min(1e-30)[:, None]
        score = _score((offset * across[:, None]).sum(dim=2) / limit, weights)
        taken = broad & (score > best)
        best = torch.where(taken, score, best)
        normal = torch.where(taken[:, None], across, normal)
    off = (offset * normal[:, None]).sum(dim=2)
    piece = off.abs() < limit
    piece &= piece.cumsum(dim=1) <= _MOST
    count = piece.sum(dim=1)
    error = ((off * piece).square().sum(dim=1) / count.clamp_min(1)).sqrt()
    enough = (best > _SHARE * weights.sum(dim=1)) & (count >= _FEWEST)
    agreed = enough & (_breadth(offset, piece) > _BROAD)
    heights = heights_over(quadrics, sites.samples[near.index]) / limit
    return agreed, agreed & (best > _GAIN * _score(heights, weights)), piece, error


def _score(off: Tensor, weights: Tensor) -> Tensor:
    """(n,) how much of neighbourhoods lies near, given distances (n, k) in tolerances."""
    return ((1 - off.square()).clamp_min(0) * weights).sum(dim=1)


def _breadth(offset: Tensor, piece: Tensor) -> Tensor:
    """(n,) how broad the chosen offsets (n, k, 3) lie, see `consensus_loops`."""
    chosen = (offset * piece[..., None]).double()
    spread = torch.einsum("nki,nkj->nij", chosen, chosen)
    total = spread.diagonal(dim1=1, dim2=2).sum(dim=1).square()
    return 0.5 * (total - spread.square().sum(dim=(1, 2))) / total.clamp_min(np.finfo(float).tiny)
