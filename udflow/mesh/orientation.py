"""One orientation per connected part, wherever the surface has two sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order

from udflow.mesh.topology import Edges, cross, parts, side_ends


def oriented(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], edges: Edges
) -> NDArray[np.int64]:
    """(f, k) triangles or quads, reversed where needed so that neighbours agree.

    Faces are neighbours where exactly two meet at an edge. A one-sided part (a Möbius strip) keeps
    a seam along which neighbours disagree. Each part is turned to enclose positive volume as seen
    from its centre: outwards where it is closed, by convention where it is open.
    """
    pair = edges.sides_where(2)
    start, _ = side_ends(faces, pair)
    disagree = start[:, 0] == start[:, 1]  # both run along the edge in the same direction
    neighbours = pair // faces.shape[1]
    label = _double_cover(neighbours, disagree, len(faces))
    one_sided = label[0] == label[1]
    if one_sided.any():
        kept = _without_cycles(neighbours, one_sided)
        label = _double_cover(neighbours[kept], disagree[kept], len(faces))
    faces = _reversed_where(faces, label[0] > label[1])
    part = np.minimum(label[0], label[1])
    return _reversed_where(faces, _volume(vertices, faces, part)[part] < 0)


def _double_cover(
    neighbours: NDArray[np.int64], disagree: NDArray[np.bool_], count: int
) -> NDArray[np.int64]:
    """(2, f) parts of the graph whose nodes are the faces as given and the faces reversed.

    In a two-sided part the two orientations fall apart; in a one-sided part they are connected.
    """
    one, two = neighbours[:, 0], neighbours[:, 1]
    across = count * disagree
    straight = np.stack([one, two + across], axis=1)
    turned = np.stack([one + count, two + count - across], axis=1)
    return parts(np.concatenate([straight, turned]), 2 * count).reshape(2, count)


def _without_cycles(neighbours: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which pairs of neighbours to keep so that only a spanning tree connects the chosen faces."""
    count = len(chosen)
    among = chosen[neighbours[:, 0]]
    part = parts(neighbours[among], count)
    nodes = np.flatnonzero(chosen)
    roots = nodes[np.unique(part[nodes], return_index=True)[1]]
    # one more node connects the parts, so that a single walk reaches them all
    joins = np.stack([np.full_like(roots, count), roots], axis=1)
    one, two = np.concatenate([neighbours[among], joins]).T
    weight = np.ones(len(one), dtype=np.int8)
    graph = coo_matrix((weight, (one, two)), shape=(count + 1, count + 1)).tocsr()
    before = breadth_first_order(graph, count, directed=False, return_predecessors=True)[1]
    one, two = neighbours.T
    in_tree = (before[one] == two) | (before[two] == one)
    # two faces may share two edges: only one of them belongs to the tree
    key = np.minimum(one, two) * count + np.maximum(one, two)
    once = np.zeros(len(key), dtype=bool)
    once[np.unique(key, return_index=True)[1]] = True
    kept: NDArray[np.bool_] = ~among | (in_tree & once)
    return kept


def _reversed_where(faces: NDArray[np.int64], where: NDArray[np.bool_]) -> NDArray[np.int64]:
    return np.where(where[:, None], faces[:, ::-1], faces)


def _volume(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], part: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Six times the volume that each part encloses with its own centre."""
    a, b, c, d = (vertices[faces[:, i % faces.shape[1]]] for i in range(4))
    size = np.maximum(np.bincount(part), 1)
    centre = np.stack([np.bincount(part, a[:, i]) / size for i in range(3)], axis=1)
    volume = ((a - centre[part]) * cross(c - a, d - b)).sum(axis=1)
    return np.asarray(np.bincount(part, volume), dtype=np.float64)
