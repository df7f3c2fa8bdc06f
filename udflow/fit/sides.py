"""On which side of the surface a query lies: one sign for each, guessed from the data.

Nobody knows inside from outside, and equation (3) does not ask: v = s grad s is the same for s and
-s. But where neighbouring regions of a network choose differently they meet in a wall, which
training removes slowly. So signs are made consistent from site to site, as far as that goes, and
say how a training begins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadric_surface import QuadricSurface

_NEIGHBOURS = 10
_THROUGH_SPACE = 0.5  # weight of links beside the surface: below those over creases and gaps
_PROBES = 50_000  # queries among which such links are looked for
_LEAST = 1e-6  # a sparse matrix takes a weight of zero for no link


@dataclass(frozen=True)
class _Links:
    """Pairs of sites: (l,) indices, whether their normals point to one side, what to trust less."""

    first: Tensor
    second: Tensor
    agree: Tensor
    weight: Tensor


def sides(surface: QuadricSurface, query: Tensor, foot: Tensor) -> Tensor:
    """Signs of queries, the same for all on one side of the surface.

    Args:
        surface: quadrics, each with a normal of no known sign.
        query, foot: (m, 3) in random order, and their nearest points of the surface.

    Returns:
        (m,) 1 or -1.
    """
    site = surface.tree.nearest(foot, 1).index[:, 0]
    normal = surface.quadrics.frame[:, 2]
    offset = query - foot
    height = (offset * normal[site]).sum(dim=1)
    part = slice(0, _PROBES)
    links = (
        _over_surface(surface, normal),
        _through_space(query[part], offset[part].norm(dim=1), site[part], height[part]),
    )
    above = height >= 0
    up = _consistent(len(normal), links)
    return torch.where(above.cpu() == up[site.cpu()], 1.0, -1.0).to(query)


def _over_surface(surface: QuadricSurface, normal: Tensor) -> _Links:
    """Neighbouring sites: alike where their normals and the way between them are."""
    origin = surface.quadrics.origin
    second = surface.tree.nearest(origin, _NEIGHBOURS + 1).index[:, 1:]
    first = torch.arange(len(origin), device=origin.device)[:, None].expand_as(second)
    first, second = first.reshape(-1), second.reshape(-1)
    cosine = (normal[first] * normal[second]).sum(dim=1)
    way = torch.nn.functional.normalize(origin[second] - origin[first], dim=1)
    rise = (way * normal[first]).sum(dim=1).abs()
    return _Links(first, second, cosine >= 0, 1 - cosine.abs() + rise)


def _through_space(query: Tensor, distance: Tensor, site: Tensor, height: Tensor) -> _Links:
    """Neighbouring queries nearer to each other than to the surface, both ways together: their
    balls are empty and overlap, so that no surface lies between them. Less is trusted where they
    do not stand upright on their sites, as beside an edge."""
    near = NeighbourTree(query).nearest(query, _NEIGHBOURS + 1)
    first, place = (near.distance < distance[:, None] + distance[near.index]).nonzero().unbind(1)
    second = near.index[first, place]
    lean = 1 - height.abs() / distance.clamp_min(_LEAST)
    weight = _THROUGH_SPACE + lean[first] + lean[second]
    return _Links(site[first], site[second], (height[first] >= 0) == (height[second] >= 0), weight)


def _consistent(sites: int, links: tuple[_Links, ...]) -> Tensor:
    """(sites,) bool, which normals to keep and which to turn, by the tree of the best links."""
    first, second, agree, weight = (
        torch.cat([getattr(part, name) for part in links]).cpu().numpy()
        for name in ("first", "second", "agree", "weight")
    )
    key = np.minimum(first, second) * sites + np.maximum(first, second)
    order = np.lexsort((weight, key))
    key, where = np.unique(key[order], return_index=True)
    agree, weight = agree[order][where], np.maximum(weight[order][where], _LEAST)
    graph = csr_matrix((weight, np.divmod(key, sites)), shape=(sites, sites))
    tree = minimum_spanning_tree(graph).tocoo()
    chosen = np.searchsorted(key, tree.row.astype(np.int64) * sites + tree.col)
    return torch.from_numpy(_two_coloured(tree, agree[chosen]))


def _two_coloured(tree: coo_matrix, agree: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) bool, so that linked nodes are equal where they agree and different where not. In a
    tree that always goes: every tree falls into two halves in its double cover."""
    n, other = tree.shape[0], np.where(agree, 0, tree.shape[0])
    first = np.concatenate([tree.row, tree.row + n])
    second = np.concatenate([tree.col + other, tree.col + n - other])
    cover = coo_matrix((np.ones(len(first)), (first, second)), shape=(2 * n, 2 * n))
    label = connected_components(cover, directed=False)[1]
    return np.asarray(label[:n] < label[n:])
