"""One orientation per connected part, wherever the surface has two sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order

from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import edges_of, face_normals, parts, side_ends


def oriented(mesh: Mesh) -> Mesh:
    """The mesh with faces reversed where needed so that neighbours agree.

    Faces are neighbours where exactly two meet at an edge. A one-sided part (a Möbius strip) keeps
    a seam along which neighbours disagree.
    """
    faces = mesh.faces
    pair = edges_of(faces).sides_where(2)
    start, _ = side_ends(faces, pair)
    disagree = start[:, 0] == start[:, 1]  # both run along the edge in the same direction
    neighbours = pair // 3
    label = _double_cover(neighbours, disagree, len(faces))
    one_sided = label[0] == label[1]
    if one_sided.any():
        tree = _spanning_tree(neighbours, one_sided)
        kept = ~one_sided[neighbours[:, 0]] | tree
        label = _double_cover(neighbours[kept], disagree[kept], len(faces))
    return _reversed_where(mesh, label[0] > label[1])


def facing_outwards(mesh: Mesh) -> Mesh:
    """The mesh with each part turned to enclose positive volume as seen from its centre: outwards
    where it is closed, by convention where it is open."""
    part = parts(mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2), len(mesh.vertices))
    part = part[mesh.faces[:, 0]]
    size = np.maximum(np.bincount(part), 1)[:, None]
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    centre = np.stack([np.bincount(part, middle[:, i]) for i in range(3)], axis=1) / size
    volume = np.bincount(part, ((middle - centre[part]) * face_normals(mesh)).sum(axis=1))
    return _reversed_where(mesh, volume[part] < 0)


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


def _spanning_tree(neighbours: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which pairs of neighbours form a spanning tree of each part of the chosen faces."""
    count = len(chosen)
    part = parts(neighbours, count)
    faces = np.flatnonzero(chosen)
    roots = faces[np.unique(part[faces], return_index=True)[1]]
    # one more node connects the parts, so that a single walk reaches them all
    joins = np.stack([np.full_like(roots, count), roots], axis=1)
    pairs = np.concatenate([neighbours[chosen[neighbours[:, 0]]], joins])
    weight = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((weight, (pairs[:, 0], pairs[:, 1])), shape=(count + 1, count + 1)).tocsr()
    before = breadth_first_order(graph, count, directed=False, return_predecessors=True)[1]
    one, two = neighbours[:, 0], neighbours[:, 1]
    in_tree = (before[one] == two) | (before[two] == one)
    # two faces may share two edges: only one of them belongs to the tree
    key = np.minimum(one, two) * count + np.maximum(one, two)
    once = np.zeros(len(key), dtype=bool)
    once[np.unique(key, return_index=True)[1]] = True
    return in_tree & once


def _reversed_where(mesh: Mesh, where: NDArray[np.bool_]) -> Mesh:
    return Mesh(mesh.vertices, np.where(where[:, None], mesh.faces[:, ::-1], mesh.faces))
