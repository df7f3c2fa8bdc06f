"""One piece of surface for each quadric: samples beyond a crease or on another sheet left out.

Near a crease the nearest samples lie on two faces and near a thin wall on both of its sides; one
quadric through all of them is wrong for each. There the quadrics of the sites around are taken as
hypotheses, the one that explains most of a site's neighbourhood is chosen, and the site's quadric
is fitted again to the samples that this one explains (the idea of robust local fits with
sharp features, Fleishman, Cohen-Or and Silva 2005).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from udflow.cloud.consensus import on_shared_planes
from udflow.cloud.fits import chosen_by_tensors
from udflow.cloud.neighbours import Neighbours
from udflow.cloud.piece_loops import piece_rows
from udflow.cloud.quadrics import LocalQuadrics, copied, heights_over, put
from udflow.cloud.sites import NEAR, Sites
from udflow.compiled import over_rows

_ROUNDS = 3
_POOL = NEAR  # nearest samples among which those of one piece are sought
_HYPOTHESES = 16  # sites around whose quadrics are tried
_CLOSE = 17  # nearest samples, the site with them, by which a quadric is judged
_WHOLE = 0.75  # share of them on the quadric that lets it pass
_FEWEST = 8  # samples of a piece that a quadric is fitted to
_GAIN = 1.5  # times better a piece must be explained than by the quadric there was
_NOISE_SITES = 48
_QUARTILE = 3.14  # standard deviations of noise in the lower quartile of its absolute values
_SLACK = 4.0  # standard deviations of noise within which a sample is on a quadric
_FINE = 0.03  # spacings within which it always is


def on_one_piece(quadrics: LocalQuadrics, sites: Sites) -> LocalQuadrics:
    """Quadrics (n) with those fitted again that run through more than one piece of surface: to a
    plane that samples share, and to what a neighbour explains.

    Errors are lowered to the noise: the lower quartile of held-back errors does not see the
    creases, which are few.

    Args:
        quadrics: fitted to all the nearest samples, one at each site.
        sites: the same.
    """
    quadrics, shared = on_shared_planes(quadrics, sites)
    error = torch.where(shared, quadrics.error, sites.narrow.quadrics.error)
    noise = _QUARTILE * sites.quantile(error, 0.25, _NOISE_SITES)
    quadrics = replace(quadrics, error=torch.minimum(quadrics.error, noise))
    tolerance = torch.maximum(_SLACK * noise, _FINE * quadrics.spacing)
    doubtful = torch.arange(len(tolerance), device=tolerance.device)
    by = by_loop if tolerance.device.type == "cpu" else by_tensors
    for _ in range(_ROUNDS):
        quadrics, doubtful = by(quadrics, sites, tolerance, doubtful)
        if len(doubtful) == 0:
            break
    return quadrics


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
    around = _Around.of(sites, doubtful, tolerance)
    index = sites.around(_HYPOTHESES)[doubtful, :_HYPOTHESES]
    return _refitted(quadrics, around, index), doubtful


def _in_doubt(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor) -> Tensor:
    """Which of some quadrics miss their own sample or too many of the nearest."""
    near = Neighbours(sites.near.distance[rows, :_CLOSE], sites.near.index[rows, :_CLOSE])
    off, limit = heights_over(quadrics[rows], sites.samples[near.index]).abs(), tolerance[rows]
    weights = _weights(near)
    on = ((off < limit[:, None]) * weights).sum(dim=1) / weights.sum(dim=1)
    return (on < _WHOLE) | (off[:, 0] > limit)


def _weights(near: Neighbours) -> Tensor:
    return torch.exp(-(near.distance / near.distance[:, -1:].clamp_min(1e-12)).square())


@dataclass(frozen=True)
class _Around:
    """The samples around doubtful sites."""

    doubtful: Tensor
    samples: Tensor
    near: Neighbours
    points: Tensor
    weights: Tensor
    tolerance: Tensor

    @classmethod
    def of(cls, sites: Sites, doubtful: Tensor, tolerance: Tensor) -> _Around:
        distance, index = sites.near.distance, sites.near.index
        near = Neighbours(distance[doubtful, :_POOL], index[doubtful, :_POOL])
        points = sites.samples[near.index]
        return cls(doubtful, sites.samples, near, points, _weights(near), tolerance[doubtful])

    def explained(self, quadrics: LocalQuadrics) -> tuple[Tensor, Tensor]:
        """How much of each neighbourhood a quadric explains (d,), and which samples (d, k)."""
        off = heights_over(quadrics, self.points).abs() / self.tolerance[:, None]
        score = ((1 - off.square()).clamp_min(0) * self.weights).sum(dim=1)
        return torch.where(off[:, 0] < 1, score, 0.0), off < 1


def _refitted(quadrics: LocalQuadrics, around: _Around, hypotheses: Tensor) -> LocalQuadrics:
    """The quadrics with the doubtful ones that a hypothesis (d, h) explains better replaced."""
    best = around.explained(quadrics[around.doubtful])[0]
    least = _GAIN * best
    chosen = around.doubtful
    for candidate in hypotheses.unbind(dim=1):
        score = around.explained(quadrics[candidate])[0]
        chosen = torch.where(score > best, candidate, chosen)
        best = torch.maximum(best, score)
    piece = around.explained(quadrics[chosen])[1]
    better = (best > least) & (best > 0) & (piece.sum(dim=1) >= _FEWEST)
    which = around.doubtful[better]
    near = Neighbours(around.near.distance[better], around.near.index[better])
    fitted = chosen_by_tensors(around.samples, near, quadrics.origin[which], piece[better])
    fitted = replace(fitted, error=quadrics.error[which], spacing=quadrics.spacing[which])
    result = copied(quadrics)
    put(result, which, fitted)
    return result
