"""How many samples each local quadric is fitted to: chosen from the data alone.

Clean data want few, so that detail stays; noisy data want many, so that noise is averaged. Two
judges decide. Held-back samples (leave-one-out) say which widths predict best, but on noisy data
their error is nearly all noise, and a width too narrow costs them little. There a second judge goes
on: a wider fit is taken as long as it changes the surface by no more than the noise explains
(the intersection of confidence intervals, Goldenshluger and Nemirovski 1997).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadrics import LocalQuadrics, feet_on_quadrics, fit_width, put

NEIGHBOUR_COUNTS = (10, 16, 24, 40, 64, 96, 144)  # widths tried for each sample
_SCORE_NEIGHBOURS = 96  # sites over which held-back errors are averaged
_CHANGE_NEIGHBOURS = 32  # sites over which changes of the surface are averaged
_FINE = 0.02  # of the spacing: a held-back error not worth a wider neighbourhood
_PATIENCE = 1.1  # times the lowest error: up to here wider ones are tried
_NOISY = 24  # neighbours from which held-back errors alone no longer decide
_CHANGE = 1.15  # mean squared change, in variances that the noise explains
_LARGEST_CHANGE = 25.0  # that one site may contribute


def fit_quadrics(sites: Tensor, samples: Tensor, tree: NeighbourTree) -> LocalQuadrics:
    """Fits a quadric at every site, each with the width that suits its neighbourhood.

    Args:
        sites: (n, 3) some of the samples, unit frame.
        samples: (m, 3) distinct points, the data.
        tree: the tree of the samples.
    """
    counts = [k for k in NEIGHBOUR_COUNTS if k <= tree.size] or [tree.size]
    choice = _Choice(sites, samples, tree, counts[0])
    for k in counts[1:]:
        if len(choice.growing) == 0:
            break
        choice.widen(k)
    return replace(choice.best, error=choice.lowest)


class _Choice:
    """The widths chosen so far, and the sites at which wider ones are worth a try."""

    def __init__(self, sites: Tensor, samples: Tensor, tree: NeighbourTree, k: int) -> None:
        self._sites, self._samples, self._tree = sites, samples, tree
        around = NeighbourTree(sites).nearest(sites, _SCORE_NEIGHBOURS).index
        self._around, self._near = around, around[:, :_CHANGE_NEIGHBOURS]
        first = fit_width(samples, tree, sites, k)
        self.best, self._variance = first.quadrics, first.variance
        self._foot = feet_on_quadrics(self.best, sites)
        self._error = self.best.error.clone()
        self._change = torch.zeros_like(self._error)
        self.lowest = self._scores()
        self.growing = (self.lowest > _FINE * self.best.spacing).nonzero().squeeze(1)

    def widen(self, k: int) -> None:
        """Tries k neighbours at the sites that are still growing."""
        sites, growing = self._sites[self.growing], self.growing
        wider = fit_width(self._samples, self._tree, sites, k)
        foot = feet_on_quadrics(wider.quadrics, sites)
        self._error[growing] = wider.quadrics.error
        score, lowest = self._scores()[growing], self.lowest[growing]
        explained = self._explained(foot, wider.variance)
        tolerable = score < _PATIENCE * lowest
        accepted = score < lowest
        if k >= _NOISY:
            accepted |= tolerable & explained
        taken = growing[accepted]
        put(self.best, taken, wider.quadrics[accepted])
        self._variance[taken], self._foot[taken] = wider.variance[accepted], foot[accepted]
        self.lowest[growing] = torch.minimum(lowest, score)
        self.growing = growing[tolerable & (self.lowest[growing] > _FINE * self._spacing(growing))]

    def _explained(self, foot: Tensor, variance: Tensor) -> Tensor:
        """Whether the noise explains by how much wider fits move the feet of growing sites."""
        growing = self.growing
        moved = (foot - self._foot[growing]).square().sum(dim=1)
        before = self._variance[growing]
        gained = torch.maximum(before - variance, 0.15 * before)
        noise = self.lowest[growing].square().clamp_min(1e-16)
        self._change[growing] = (moved / (noise * gained)).clamp_max(_LARGEST_CHANGE)
        return self._change[self._near].mean(dim=1)[growing] < _CHANGE

    def _scores(self) -> Tensor:
        """(n,) root of the mean squared held-back error around each site."""
        return self._error.square()[self._around].mean(dim=1).sqrt()

    def _spacing(self, which: Tensor) -> Tensor:
        return self.best.spacing[which]
