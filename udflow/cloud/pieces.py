"""One piece of surface for each quadric: samples beyond a crease or on another sheet left out.

Near a crease the nearest samples lie on two faces and near a thin wall on both of its sides; one
quadric through all of them is wrong for each. There the quadrics of the sites around are taken as
hypotheses, the one that explains most of a site's neighbourhood is chosen, and the site's quadric
is fitted again to the samples that this one explains (the idea of robust local fits with
sharp features, Fleishman, Cohen-Or and Silva 2005).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from udflow.cloud.consensus import on_shared_planes
from udflow.cloud.fits import chosen_by_tensors
from udflow.cloud.neighbourhoods import Neighbourhoods
from udflow.cloud.neighbours import Neighbours
from udflow.cloud.piece_loops import piece_rows
from udflow.cloud.quadrics import LocalQuadrics, copied, put
from udflow.cloud.sites import NEAR, Sites
from udflow.cloud.strips import on_strips
from udflow.compiled import over_rows

_ROUNDS = 3
_POOL = NEAR  # nearest samples among which those of one piece are sought
_HYPOTHESES = 16  # sites around whose quadrics are tried
_CLOSE = 17  # nearest samples, the site with them, by which a quadric is judged
_WHOLE = 0.75  # share of them on the quadric that lets it pass
_FEWEST = 8  # samples of a piece that a quadric is fitted to
_GAIN = 1.5  # times better a piece must be explained than by the quadric there was
_NOISE_SITES = 48
_SLACK = 4.0  # standard deviations of noise within which a sample is on a quadric
_FINE = 0.03  # spacings within which it always is


def on_one_piece(quadrics: LocalQuadrics, sites: Sites) -> LocalQuadrics:
    """Quadrics (n) with those fitted again that run through more than one piece of surface: to a
    plane that samples share, to what a neighbour explains, and on strips to what little there is.

    Errors are lowered to the noise: the lower quartile of held-back errors does not see the
    creases, which are few.

    Args:
        quadrics: fitted to all the nearest samples, one at each site.
        sites: the same.
    """
    quadrics, shared = on_shared_planes(quadrics, sites)
    error = torch.where(shared, quadrics.error, sites.narrow.quadrics.error)
    noise = sites.noise(error, _NOISE_SITES)
    quadrics = replace(quadrics, error=torch.minimum(quadrics.error, noise))
    tolerance = torch.maximum(_SLACK * noise, _FINE * quadrics.spacing)
    doubtful = torch.arange(len(tolerance), device=tolerance.device)
    by = by_loop if tolerance.device.type == "cpu" else by_tensors
    for _ in range(_ROUNDS):
        quadrics, doubtful = by(quadrics, sites, tolerance, doubtful)
        if len(doubtful) == 0:
            return quadrics
    return on_strips(quadrics, sites, tolerance, doubtful)


def by_loop(
    quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor
) -> tuple[LocalQuadrics, Tensor]:
    """One round on the CPU.

    Args:
        quadrics: (n) as they are.
        sites: theirs.
        tolerance: (n,) distance from a quadric up to which a sample is explained by it.
        rows: which of the quadrics may be in doubt.

    Returns:
        The quadrics with some fitted again, and which of the rows were in doubt.
    """
    near, around = sites.near, sites.around(_HYPOTHESES)
    width = near.index.shape[1]
    limits = (min(_CLOSE, width), min(_POOL, width), min(_HYPOTHESES, around.shape[1]),
              _WHOLE, _GAIN, _FEWEST)  # fmt: skip
    result, doubtful = copied(quadrics), torch.empty(len(rows), dtype=torch.bool)
    known = (rows, sites.samples.contiguous(), quadrics.origin, quadrics.frame,
             quadrics.coefficients, quadrics.radius, tolerance, near.distance, near.index,
             around)  # fmt: skip
    changed = (result.frame, result.coefficients, result.radius, result.count, doubtful)
    over_rows(piece_rows, len(rows), *(a.contiguous().numpy() for a in known), limits,
              *(a.numpy() for a in changed))  # fmt: skip
    return result, rows[doubtful]


def by_tensors(
    quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor
) -> tuple[LocalQuadrics, Tensor]:
    """The same on any device."""
    doubtful = rows[_in_doubt(quadrics, sites, tolerance, rows)]
    return _refitted(quadrics, sites, tolerance, doubtful), doubtful


def _in_doubt(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor) -> Tensor:
    """Which of some quadrics miss their own sample or too many of the nearest."""
    around = Neighbourhoods.of(sites, rows, tolerance, _CLOSE)
    piece = around.explained(quadrics[rows])[1]
    on = (piece * around.weights).sum(dim=1) / around.weights.sum(dim=1)
    return (on < _WHOLE) | ~piece[:, 0]


def _refitted(
    quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, doubtful: Tensor
) -> LocalQuadrics:
    """The quadrics with the doubtful ones that a neighbour's explains better fitted again."""
    around = Neighbourhoods.of(sites, doubtful, tolerance, _POOL)
    own = around.explained(quadrics[doubtful])[0]
    others = sites.around(_HYPOTHESES)[doubtful, :_HYPOTHESES]
    chosen, best = around.best(quadrics, doubtful, others)
    piece = around.explained(quadrics[chosen])[1]
    better = (best > _GAIN * own) & (best > 0) & (piece.sum(dim=1) >= _FEWEST)
    which = doubtful[better]
    near = Neighbours(around.near.distance[better], around.near.index[better])
    fitted = chosen_by_tensors(sites.samples, near, quadrics.origin[which], piece[better])
    fitted = replace(fitted, error=quadrics.error[which], spacing=quadrics.spacing[which])
    result = copied(quadrics)
    put(result, which, fitted)
    return result
