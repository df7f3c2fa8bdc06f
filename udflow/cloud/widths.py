"""How many samples each local quadric is fitted to: chosen from the data alone.

Clean data want few, so that detail stays; noisy data want many, so that noise is averaged. Two
judges decide. Held-back samples (leave-one-out) say which widths predict best, but on noisy data
their error is nearly all noise, and a width too narrow costs them little. There a second judge goes
on: a wider fit is taken as long as it changes the surface by no more than the noise explains
(the intersection of confidence intervals, Goldenshluger and Nemirovski 1997).

Neither can judge where the noise is as large as the neighbourhood: its samples fill a ball, there
is no surface to be missed, and the error is a share of the ball's radius. There wider fits are
taken until the samples are flat, unless a wide one shows two sheets: errors of one size.
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
_FILLED = 0.22  # of the radius: noise from which the samples fill a ball
_FLAT = 0.17  # of the radius: noise below which they show a surface again
_WIDE = 64  # neighbours that tell sheets from noise
_MOST = 0.5  # of the sites around
_SHEETS = 1.15  # times what it is for noise: the lower quartile of errors beside their mean square
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
        self._filled = self._fill_balls()
        self.growing = self._worth_more(self._row)

    def widen(self, k: int) -> None:
        """Tries k neighbours at the sites that are still growing."""
        growing = self.growing
        wider = self._fitted(k)
        filled = self._filled[growing] & self._thicker(_FLAT, growing)
        self._error[growing] = wider.quadrics.error
        score, lowest = self._scores(growing), self.lowest[growing]
        explained = self._explained(wider)  # at every width, for those that stop
        tolerable = filled | (score < _PATIENCE * lowest)
        accepted = filled | (score < lowest)
        if k >= _NOISY:
            accepted |= tolerable & explained
        taken = growing[accepted]
        put(self.best, taken, wider.quadrics[accepted])
        self._variance[taken], self._foot[taken] = wider.variance[accepted], wider.foot[accepted]
        self.lowest[growing] = torch.where(filled, score, torch.minimum(lowest, score))
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

    def _fill_balls(self) -> Tensor:
        """(n,) bool, sites around which the samples fill balls as large as the narrowest fits, and
        are not two sheets."""
        sites, filled = self._sites, self._thicker(_FILLED, self._row)
        rows = filled.nonzero().squeeze(1)
        if len(rows) == 0:
            return filled
        errors = self._error.clone()
        wide = fit_width(sites.samples, sites.tree, sites.origin[rows], _WIDE)
        errors[rows] = wide.quadrics.error
        noise = sites.noise(errors, _SCORE_NEIGHBOURS, rows)
        scatter = sites.mean(errors.square(), _SCORE_NEIGHBOURS, rows).sqrt()
        ball = filled.float()
        ball[rows] = (noise < _SHEETS * scatter).float()
        filled[rows] = sites.mean(ball, _SCORE_NEIGHBOURS, rows) > _MOST
        return filled

    def _thicker(self, share: float, rows: Tensor) -> Tensor:
        """Whether noise is more than a share of the radii of the fits at some sites. At creases few
        errors are large, which is no noise."""
        limit = share * self.best.radius[rows]
        thicker = self.lowest[rows] > limit
        noise = self._sites.noise(self._error, _SCORE_NEIGHBOURS, rows[thicker])
        thicker[thicker.clone()] = noise > limit[thicker]
        return thicker

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
