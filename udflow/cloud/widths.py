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

from udflow.cloud.fits import Fits, fit_nearest, fit_width
from udflow.cloud.quadrics import LocalQuadrics, copied, put
from udflow.cloud.sites import NARROW, Sites

NEIGHBOUR_COUNTS = (NARROW, 16, 24, 40, 64, 96, 144)  # widths tried for each sample
_SCORE_NEIGHBOURS = 96  # sites over which held-back errors are averaged
_CHANGE_NEIGHBOURS = 32  # sites over which changes of the surface are averaged
_FINE = 0.02  # of the spacing: a held-back error not worth a wider neighbourhood
_PATIENCE = 1.1  # times the lowest error: up to here wider ones are tried
_NOISY = 24  # neighbours from which held-back errors alone no longer decide
_CHANGE = 1.15  # mean squared change, in variances that the noise explains
_LARGEST_CHANGE = 25.0  # that one site may contribute
_KEPT = 1 << 15  # sites whose neighbours for all the widths are kept in memory


def fit_quadrics(sites: Sites) -> LocalQuadrics:
    """Fits a quadric at every site, each with the width that suits its neighbourhood."""
    choice = _Choice(sites)
    for k in NEIGHBOUR_COUNTS[1:]:
        if k > sites.tree.size or len(choice.growing) == 0:
            break
        choice.widen(k)
    return replace(choice.best, error=choice.lowest)


class _Choice:
    """The widths chosen so far, and the sites at which wider ones are worth a try."""

    def __init__(self, sites: Sites) -> None:
        sites.around(_SCORE_NEIGHBOURS)  # and not fewer first
        self._sites, self._near = sites, sites.near
        first = sites.narrow
        self.best, self._variance = copied(first.quadrics), first.variance.clone()
        self._foot = first.foot.clone()
        self._error = first.quadrics.error.clone()
        self._change = torch.zeros_like(self._error)
        self.lowest = self._scores()
        self._row = torch.arange(len(self._error), device=self._error.device)
        self.growing = self._worth_more(self._row)

    def widen(self, k: int) -> None:
        """Tries k neighbours at the sites that are still growing."""
        growing, wider = self.growing, self._fitted(k)
        self._error[growing] = wider.quadrics.error
        score, lowest = self._scores(growing), self.lowest[growing]
        explained = self._explained(wider)  # at every width, for those that stop
        tolerable = score < _PATIENCE * lowest
        accepted = score < lowest
        if k >= _NOISY:
            accepted |= tolerable & explained
        taken = growing[accepted]
        put(self.best, taken, wider.quadrics[accepted])
        self._variance[taken], self._foot[taken] = wider.variance[accepted], wider.foot[accepted]
        self.lowest[growing] = torch.minimum(lowest, score)
        self.growing = self._worth_more(growing[tolerable])

    def _fitted(self, k: int) -> Fits:
        sites, growing = self._sites, self.growing
        origin = sites.origin[growing]
        if k > self._near.index.shape[1] and len(growing) <= _KEPT:
            self._near = sites.tree.nearest(origin, NEIGHBOUR_COUNTS[-1])
            self._row[growing] = torch.arange(len(growing), device=growing.device)
        if k > self._near.index.shape[1]:
            return fit_width(sites.samples, sites.tree, origin, k)
        return fit_nearest(sites.samples, origin, self._near, k, self._row[growing])

    def _explained(self, wider: Fits) -> Tensor:
        """Whether the noise explains by how much wider fits move the feet of growing sites."""
        growing = self.growing
        moved = (wider.foot - self._foot[growing]).square().sum(dim=1)
        before = self._variance[growing]
        gained = torch.maximum(before - wider.variance, 0.15 * before)
        noise = self.lowest[growing].square().clamp_min(1e-16)
        self._change[growing] = (moved / (noise * gained)).clamp_max(_LARGEST_CHANGE)
        return self._sites.mean(self._change, _CHANGE_NEIGHBOURS, growing) < _CHANGE

    def _scores(self, which: Tensor | None = None) -> Tensor:
        """Roots of the mean squared held-back error around each site, or around some."""
        return self._sites.mean(self._error.square(), _SCORE_NEIGHBOURS, which).sqrt()

    def _worth_more(self, which: Tensor) -> Tensor:
        """Those of some sites whose error is not yet small against their spacing."""
        return which[self.lowest[which] > _FINE * self.best.spacing[which]]
