"""Edges and parts of polygons: what orientation, trimming and cleaning ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from udflow.mesh.topology_loops import deal_out, sort_sides


@dataclass(frozen=True)
class Edges:
    """The undirected edges of polygons with k corners, each with the sides that lie on it.

    Side k f + c of face f runs from its corner c to the next.

    Attributes:
        ends: (e, 2) int64 vertices, the lower first.
        first: (e + 1,) int64, edge i owns sides[first[i] : first[i + 1]].
        sides: (k f,) int64.
    """

    ends: NDArray[np.int64]
    first: NDArray[np.int64]
    sides: NDArray[np.int64]

    @property
    def count(self) -> NDArray[np.int64]:
        """(e,) number of faces at each edge: 1 on a border, 2 inside, more where sheets join."""
        return np.diff(self.first)

    def sides_where(self, count: int) -> NDArray[np.int64]:
        """(n, count) sides of the edges that have exactly `count` faces."""
        start = self.first[:-1][self.count == count]
        sides: NDArray[np.int64] = self.sides[start[:, None] + np.arange(count)]
        return sides


def edges_of(faces: NDArray[np.int64]) -> Edges:
    """The edges of (f, k) faces, in the order of their vertices."""
    count = faces.size
    sides, ends = np.empty(count, np.int64), np.empty((count, 2), np.int64)
    pile, first = np.zeros(int(faces.max(initial=0)) + 2, np.int64), np.empty(count + 1, np.int64)
    found = sort_sides(np.ascontiguousarray(faces), pile, sides, ends, first)
    return Edges(ends[:found], first[: found + 1], sides)


def faces_around(
    faces: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The faces at each of `count` vertices, given (f, k) corners.

    Returns:
        first, (count + 1,), and around, (k f,): the faces at vertex i, in their order, are
        around[first[i] : first[i + 1]].
    """
    first, around = np.zeros(count + 1, np.int64), np.empty(faces.size, np.int64)
    deal_out(np.ascontiguousarray(faces).reshape(-1), first, around, faces.shape[1])
    return first, around


def with_any(corners: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(f,) whether at least one of the corners (f, k) is among the chosen vertices (v,)."""
    found = chosen[corners[:, 0]]
    for column in range(1, corners.shape[1]):
        found |= chosen[corners[:, column]]
    return found


def side_ends(
    faces: NDArray[np.int64], sides: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Start and end vertex of some sides of (f, k) faces."""
    corners = faces.reshape(-1)
    k = faces.shape[1]
    return corners[sides], corners[sides - sides % k + (sides + 1) % k]


def side_pairs(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k f, 2) start and end vertex of every side of (f, k) faces."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def means_of_others(
    vertices: NDArray[np.float64], pairs: NDArray[np.int64], chosen: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n, 3) for each of the chosen vertices, in ascending order, the mean of those it is paired
    with; `pairs` (p, 2) are of chosen vertices and others."""
    slot = np.searchsorted(chosen, pairs[:, 0])
    others = vertices[pairs[:, 1]]
    degree = np.bincount(slot, minlength=len(chosen))
    return np.stack([np.bincount(slot, others[:, i]) / degree for i in range(3)], axis=1)


def parts(pairs: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(count,) number of the connected part that each node is in, given (p, 2) connected pairs."""
    weight = np.ones(len(pairs), dtype=np.int8)
    one, two = pairs.astype(np.int32).T
    graph = coo_matrix((weight, (one, two)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(label, dtype=np.int64)


def cross(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) vector products; several times faster than numpy's for long arrays."""
    return np.stack(
        [
            one[:, 1] * two[:, 2] - one[:, 2] * two[:, 1],
            one[:, 2] * two[:, 0] - one[:, 0] * two[:, 2],
            one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0],
        ],
        axis=1,
    )


def face_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """(f, 3) normals of triangles, as long as twice the area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return cross(b - a, c - a)


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """(v, 3) unit normals, means over the triangles around, which must agree in orientation."""
    normal = face_normals(vertices, faces)
    total = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(faces[:, corner], normal[:, axis], len(vertices))
    unit: NDArray[np.float64] = total / np.maximum(
        np.linalg.norm(total, axis=1, keepdims=True), 1e-30
    )
    return unit
