"""Quadrics on strips: pieces of surface with fewer samples than a quadric of their own needs.

The rim of a thin wall, a chamfer, a narrow rib: they are broader than nothing and narrower than the
distance between samples, and what is fitted to the neighbourhood there lies aslant between two
faces or misses its own site. Such quadrics explain next to none of the samples around, and two
others are tried in their place:

* a plane that a few samples of a wide neighbourhood share to within a few ten-thousandths of a
  spacing. By chance hardly ever five do so; samples of a flat strip do, if they carry no noise;
* the quadric of a neighbour that is not such a one and runs through the site, as it is, where there
  is hardly any noise.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from udflow.cloud.consensus import Asked, fitted_to, shared_planes
from udflow.cloud.neighbourhoods import Neighbourhoods
from udflow.cloud.quadrics import LocalQuadrics, copied, moved, put
from udflow.cloud.sites import NEAR, Sites

_FEW = 9  # samples around: a quadric that explains fewer is none
_EXACT = Asked(pool=96, corners=20, angle=0.05, tolerance=2e-4, share=0.0, broad=1e-4, fewest=5,
               most=16, gain=1.0)  # fmt: skip
_HYPOTHESES = 16  # sites around whose quadrics are tried
_ROUNDS = 2  # so that a strip's first good quadric serves its next sites
_GAIN = 1.2  # times more a neighbour's must explain than the quadric there was
_FEWEST = 4  # samples, the site with them, that it must run through
_CLEAN = 0.05  # spacings: with more tolerance against noise, to run through the site says little
_CHUNK = 1 << 15  # quadrics judged together: bounds memory


def on_strips(
    quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor
) -> LocalQuadrics:
    """Quadrics (n) with those replaced that explain next to nothing, where something else does.

    Args:
        quadrics: one at each site.
        sites: the same.
        tolerance: (n,) distance from a quadric up to which a sample is explained by it.
        rows: which of them to look at.
    """
    lost = torch.cat([_lost(quadrics, sites, tolerance, part) for part in rows.split(_CHUNK)])
    if len(lost) == 0:
        return quadrics
    result = copied(quadrics)
    lost = _on_exact_planes(result, sites, lost)
    lost = lost[tolerance[lost] < _CLEAN * quadrics.spacing[lost]]
    for _ in range(_ROUNDS):
        lost = _taken_over(result, sites, tolerance, lost)
    return result


def _lost(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, rows: Tensor) -> Tensor:
    """Those of some quadrics that explain next to nothing."""
    around = Neighbourhoods.of(sites, rows, tolerance, NEAR)
    score, piece = around.explained(quadrics[rows])
    return rows[(score <= 0) | (piece.sum(dim=1) < _FEW)]


def _on_exact_planes(quadrics: LocalQuadrics, sites: Sites, lost: Tensor) -> Tensor:
    """Puts quadrics on planes that samples share exactly, in place; which are still lost."""
    near = sites.tree.nearest(sites.origin[lost], _EXACT.pool)
    own = quadrics[lost]
    shared = shared_planes(own, sites.samples, near, _EXACT)
    which = shared.better.nonzero().squeeze(1)
    if len(which) > 0:
        put(quadrics, lost[which], fitted_to(shared, own, sites.samples, near, which))
    return lost[~shared.better]


def _taken_over(quadrics: LocalQuadrics, sites: Sites, tolerance: Tensor, lost: Tensor) -> Tensor:
    """Puts neighbours' quadrics that are not lost themselves in the place of lost ones, in place;
    which are still lost."""
    around = Neighbourhoods.of(sites, lost, tolerance, NEAR)
    own = around.explained(quadrics[lost])[0]
    known = torch.ones(len(tolerance), dtype=torch.bool, device=tolerance.device)
    known[lost] = False
    others = sites.around(_HYPOTHESES)[lost, :_HYPOTHESES]
    others = torch.where(known[others], others, lost[:, None])
    chosen, most = around.best(quadrics, lost, others)
    enough = around.explained(quadrics[chosen])[1].sum(dim=1) >= _FEWEST
    better = enough & (most > _GAIN * own)
    which = lost[better]
    taken = moved(quadrics[chosen[better]], quadrics.origin[which])
    put(quadrics, which, replace(taken, error=quadrics.error[which],
                                 spacing=quadrics.spacing[which]))  # fmt: skip
    return lost[~better]
