"""Samples that lie on no surface: stray returns, dust, foliage.

They are far from their neighbours, and no surface passes through these: it misses them by a good
part of the distances between them. Either alone proves nothing. Far walls are sparse and smooth,
noisy and intricate places are rough and dense; both stay.
"""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.cloud.fits import fit_nearest
from udflow.cloud.neighbours import Neighbours, NeighbourTree

SPARSE = 3.0  # median spacings: samples nearer to their neighbours stay
ROUGH = 0.3  # spacings: by how much samples together may miss surfaces through their neighbours
FLAT = 0.05  # spacings: a sample that misses its own by less stays
_ASIDE = 0.9  # of the distance to the farthest neighbour: all of them lie far off, on one side
_NEIGHBOURS = 10  # that a surface is laid through
_WITNESSES = 9  # sparse samples, itself among them, that decide together
_PASSES = 5  # without the first ones, those hidden among them show


def without_scattered(samples: Tensor) -> Tensor:
    """(k,) the rows of (m, 3) distinct samples, in order, that are not scattered in space."""
    kept = torch.arange(len(samples), device=samples.device)
    for _ in range(_PASSES):
        scattered = _scattered(samples[kept])
        if len(scattered) == 0 or len(kept) - len(scattered) < _NEIGHBOURS:
            break
        stays = torch.ones(len(kept), dtype=torch.bool, device=kept.device)
        stays[scattered] = False
        kept = kept[stays]
    return kept


def _scattered(samples: Tensor) -> Tensor:
    """(k,) rows of samples that are sparse, among sparse ones through which no surface passes."""
    near = NeighbourTree(samples).nearest(samples, _NEIGHBOURS)
    spacing = near.spacing
    sparse = (spacing > SPARSE * spacing.median()).nonzero().squeeze(1)
    if len(sparse) == 0:
        return sparse
    places = samples[sparse]
    missed = _missed(samples, near, sparse) / spacing[sparse]
    witnesses = NeighbourTree(places).nearest(places, _WITNESSES).index
    rough = missed.clamp_max(1.0)[witnesses].square().mean(dim=1).sqrt()
    return sparse[(rough > ROUGH) & (missed > FLAT)]


def _missed(samples: Tensor, near: Neighbours, rows: Tensor) -> Tensor:
    """(n,) how far the samples of (n,) rows lie from the surface through their neighbours;
    infinite where these are a heap far away, which says nothing about a surface here."""
    places = samples[rows]
    offset = samples[near.index[rows, 1:]] - places[:, None]
    aside = offset.mean(dim=1).norm(dim=1) > _ASIDE * near.distance[rows, -1]
    error = fit_nearest(samples, places, near, _NEIGHBOURS, rows).quadrics.error
    return torch.where(aside, torch.inf, error)
