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

from udflow.cloud.neighbours import Neighbours, NeighbourTree
from udflow.cloud.quadrics import LocalQuadrics, fit_chosen, fit_width, heights_over, put

_ROUNDS = 3
_POOL = 40  # nearest samples among which those of one piece are sought
_HYPOTHESES = 16  # sites around whose quadrics are tried
_CLOSE = 17  # nearest samples, the site with them, by which a quadric is judged
_WHOLE = 0.75  # share of them on the quadric that lets it pass
_FEWEST = 8  # samples of a piece that a quadric is fitted to
_GAIN = 1.5  # times better a piece must be explained than by the quadric there was
_NARROW = 10  # neighbours of the fits by which the noise is judged
_NOISE_SITES = 48
_QUARTILE = 3.14  # standard deviations of noise in the lower quartile of its absolute values
_SLACK = 4.0  # standard deviations of noise within which a sample is on a quadric
_FINE = 0.03  # spacings within which it always is


def on_one_piece(quadrics: LocalQuadrics, samples: Tensor, tree: NeighbourTree) -> LocalQuadrics:
    """Quadrics (n) with those fitted again that run through more than one piece of surface.

    Args:
        quadrics: fitted to all the nearest samples.
        samples: (m, 3) the data.
        tree: the tree of the samples.
    """
    sites = NeighbourTree(quadrics.origin)
    tolerance = _tolerance(quadrics, sites, samples, tree)
    for _ in range(_ROUNDS):
        doubtful = _doubtful(quadrics, samples, tree, tolerance)
        if len(doubtful) == 0:
            break
        around = _Around.of(quadrics, doubtful, tolerance, samples, tree)
        index = sites.nearest(quadrics.origin[doubtful], _HYPOTHESES).index
        quadrics = _refitted(quadrics, around, index)
    return quadrics


def _tolerance(
    quadrics: LocalQuadrics, sites: NeighbourTree, samples: Tensor, tree: NeighbourTree
) -> Tensor:
    """(n,) distance from a quadric up to which a sample is explained by it.

    The lower quartile of held-back errors does not see the creases, which are few.
    """
    error = fit_width(samples, tree, quadrics.origin, _NARROW).quadrics.error
    near = sites.nearest(quadrics.origin, _NOISE_SITES).index
    noise = _QUARTILE * error[near].quantile(0.25, dim=1)
    return torch.maximum(_SLACK * noise, _FINE * quadrics.spacing)


def _doubtful(
    quadrics: LocalQuadrics, samples: Tensor, tree: NeighbourTree, tolerance: Tensor
) -> Tensor:
    """Indices of the quadrics that miss their own sample or too many of the nearest."""
    near = tree.nearest(quadrics.origin, _CLOSE)
    off = heights_over(quadrics, samples[near.index]).abs()
    weights = _weights(near)
    on = ((off < tolerance[:, None]) * weights).sum(dim=1) / weights.sum(dim=1)
    return ((on < _WHOLE) | (off[:, 0] > tolerance)).nonzero().squeeze(1)


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
    def of(
        cls,
        quadrics: LocalQuadrics,
        doubtful: Tensor,
        tolerance: Tensor,
        samples: Tensor,
        tree: NeighbourTree,
    ) -> _Around:
        near = tree.nearest(quadrics.origin[doubtful], _POOL)
        points = samples[near.index]
        return cls(doubtful, samples, near, points, _weights(near), tolerance[doubtful])

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
    fitted = fit_chosen(around.samples, near, quadrics.origin[which], piece[better])
    fitted = replace(fitted, error=quadrics.error[which], spacing=quadrics.spacing[which])
    result = quadrics[torch.arange(len(quadrics.origin), device=which.device)]
    put(result, which, fitted)
    return result
