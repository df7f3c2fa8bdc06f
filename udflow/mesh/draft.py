"""A mesh in the making: triangles, and where they may still be open or joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.topology import Edges, edges_of, with_any

Project = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # (n, 3) points to the surface


@dataclass(frozen=True)
class Draft:
    """Triangles between the dual surface and the finished mesh.

    Attributes:
        vertices: (v, 3) float64.
        faces: (f, 3) int64.
        loose: (v,) bool, true at least at the ends of all edges that have not exactly two faces,
            so that the rest of the surface need not be searched for them.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    loose: NDArray[np.bool_]

    def replaced(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Draft:
        """With further vertices, all of them loose, and these faces instead."""
        loose = np.concatenate([self.loose, np.ones(len(vertices), dtype=bool)])
        return Draft(np.concatenate([self.vertices, vertices]), faces, loose)

    def compacted(self) -> Draft:
        """Without the vertices that no face uses; order is kept."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces.reshape(-1)] = True
        number = np.cumsum(used) - 1
        return Draft(self.vertices[used], number[self.faces], self.loose[used])

    def loose_edges(self) -> Edges:
        """The edges at loose vertices, among them all that have not exactly two faces."""
        near = np.flatnonzero(with_any(self.faces, self.loose))
        edges = edges_of(self.faces[near])
        kept = with_any(edges.ends, self.loose)
        sides = edges.sides[np.repeat(kept, edges.count)]
        first = np.concatenate([[0], np.cumsum(edges.count[kept])])
        return Edges(edges.ends[kept], first, 3 * near[sides // 3] + sides % 3)
