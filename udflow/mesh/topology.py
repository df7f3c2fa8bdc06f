"""Edges and parts of triangles: what cleaning, trimming and orientation ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from udflow.mesh.mesh import Mesh


@dataclass(frozen=True)
class Edges:
    """The undirected edges of triangles, each with the triangle sides that lie on it.

    Side 3f + c of face f runs from its corner c to its corner c + 1.

    Attributes:
        ends: (e, 2) int64 vertices, the lower first.
        first: (e + 1,) int64, edge i owns sides[first[i] : first[i + 1]].
        sides: (3f,) int64.
    """

    ends: NDArray[np.int64]
    first: NDArray[np.int64]
    sides: NDArray[np.int64]

    @property
    def count(self) -> NDArray[np.int64]:
        """(e,) number of faces at each edge: 1 on a border, 2 inside, more where sheets join."""
        return np.diff(self.first)

    def sides_where(self, count: int) -> NDArray[np.int64]:
        """(k, count) sides of the edges that have exactly `count` faces."""
        start = self.first[:-1][self.count == count]
        return self.sides[start[:, None] + np.arange(count)]


def edges_of(faces: NDArray[np.int64]) -> Edges:
    """The edges of (f, 3) faces."""
    start, end = side_ends(faces, np.arange(faces.size))
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(faces.max(initial=0)) + 1) + high
    sides = np.argsort(key, kind="stable")
    ordered = key[sides]
    is_first = np.ones(len(ordered), dtype=bool)
    is_first[1:] = ordered[1:] != ordered[:-1]
    first = np.flatnonzero(is_first)
    leader = sides[first]
    ends = np.stack([low[leader], high[leader]], axis=1)
    return Edges(ends, np.append(first, len(ordered)), sides)


def side_ends(
    faces: NDArray[np.int64], sides: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Start and end vertex of each side."""
    corners = faces.reshape(-1)
    return corners[sides], corners[sides - sides % 3 + (sides + 1) % 3]


def side_pairs(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """(3f, 2) start and end vertex of every side."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def parts(pairs: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(count,) number of the connected part that each node is in, given (p, 2) connected pairs."""
    weight = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((weight, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(label, dtype=np.int64)


def compacted(mesh: Mesh) -> Mesh:
    """The mesh without the vertices that no face uses; order is kept."""
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.faces.reshape(-1)] = True
    number = np.cumsum(used) - 1
    return Mesh(mesh.vertices[used], number[mesh.faces])


def face_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(f, 3) normals as long as twice the area of their face."""
    corner = mesh.vertices[mesh.faces]
    one, two = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return np.stack(
        [
            one[:, 1] * two[:, 2] - one[:, 2] * two[:, 1],
            one[:, 2] * two[:, 0] - one[:, 0] * two[:, 2],
            one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0],
        ],
        axis=1,
    )


def vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """(v, 3) unit normals, means over the faces around; faces should be oriented."""
    normal = face_normals(mesh)
    count = len(mesh.vertices)
    total = np.zeros((count, 3))
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(mesh.faces[:, corner], normal[:, axis], count)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
