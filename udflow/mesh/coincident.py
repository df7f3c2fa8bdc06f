"""No two vertices in one place: what other programs weld must not change what hangs together.

Feet fall together at the ends of creases and at corners. Such vertices make faces without area, and
a program that welds by position, as all that read STL do, turns them into junctions of sheets and
tears of topology.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import parts, with_any

NEAR = 0.02  # voxels between vertices that count as one place

_Row = tuple[int, int, int]


def without_coincident(mesh: Mesh, voxel: float) -> Mesh:
    """The mesh without vertices in one place: made one where the surface stays a manifold with
    the same borders and handles, else moved apart by as little as tells them apart.

    Args:
        mesh: triangles.
        voxel: edge of a voxel, in the units of the mesh.
    """
    reach = NEAR * voxel
    pairs = cKDTree(mesh.vertices).query_pairs(reach, output_type="ndarray").astype(np.int64)
    if len(pairs) == 0:
        return mesh
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    touched = np.zeros(len(mesh.vertices), dtype=bool)
    touched[pairs] = True
    near = with_any(mesh.faces, touched)
    stars = _Stars(mesh.faces[near])
    left = stars.merged(pairs)
    vertices = _apart(mesh.vertices, stars, left, reach)
    faces = np.concatenate([mesh.faces[~near], stars.faces()])
    used, numbers = np.unique(faces, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return replace(mesh, vertices=vertices[used], faces=numbers.reshape(-1, 3), colors=colors)


class _Stars:
    """The faces at some vertices, to be merged pair by pair; such pairs are few."""

    def __init__(self, faces: NDArray[np.int64]) -> None:
        """Takes all faces (f, 3) at the vertices that may be merged."""
        self._rows: dict[int, _Row] = dict(enumerate(map(tuple, faces.tolist())))
        self._around: defaultdict[int, set[int]] = defaultdict(set)
        for number, row in self._rows.items():
            for vertex in row:
                self._around[vertex].add(number)

    def faces(self) -> NDArray[np.int64]:
        """What is left of the faces."""
        return np.array(list(self._rows.values()), dtype=np.int64).reshape(-1, 3)

    def merged(self, pairs: NDArray[np.int64]) -> list[tuple[int, int]]:
        """Makes one vertex of each pair (p, 2) that allows it; the pairs that do not, renamed.

        A merger may allow another one that was refused before, so pairs are asked until nothing
        changes.
        """
        name: dict[int, int] = {}
        waiting = [(one, two) for one, two in pairs.tolist()]
        changed = True
        while changed:
            changed, refused = False, []
            for one, two in waiting:
                a, b = _renamed(name, one), _renamed(name, two)
                if a == b or not (self._around[a] and self._around[b]):
                    continue
                if self._may_merge(a, b):
                    self._merge(a, b)
                    name[b], changed = a, True
                else:
                    refused.append((a, b))
            waiting = refused
        return waiting

    def neighbours(self, vertex: int) -> Counter[int]:
        """The vertices around one, each with the number of faces at the edge to it."""
        count = Counter(corner for row in self._around[vertex] for corner in self._rows[row])
        del count[vertex]
        return count

    def _may_merge(self, a: int, b: int) -> bool:
        """Whether one vertex in place of two leaves the surface a manifold of the same topology.

        The link condition: an edge may vanish if its ends have no common neighbours but the tips
        of its faces. Two faces folded onto each other may vanish as if their edge was turned
        first.
        """
        at_a, at_b = self.neighbours(a), self.neighbours(b)
        if max(at_a.values()) > 2 or max(at_b.values()) > 2:
            return False
        common = at_a.keys() & at_b.keys()
        borders = (1 in at_a.values()) + (1 in at_b.values())
        if b not in at_a:
            return borders == 0 and len(common) == 2 and self._folded(a, b, common)
        across = borders == 2 and at_a[b] == 2  # from border to border
        return len(common) == at_a[b] and not across and not self._would_vanish(a, b)

    def _would_vanish(self, a: int, b: int) -> bool:
        """Whether nothing would be left of a single face, or of a tetrahedron."""
        rows = [set(self._rows[row]) for row in self._around[a] | self._around[b]]
        bases = [frozenset(row - {a, b}) for row in rows if not {a, b} <= row]
        return not bases or len(set(bases)) < len(bases)

    def _folded(self, a: int, b: int, common: set[int]) -> bool:
        """Whether two faces with these tips share the edge between the common neighbours."""
        tips = {
            corner
            for vertex in (a, b)
            for row in self._around[vertex]
            if common <= set(self._rows[row])
            for corner in self._rows[row]
        }
        return tips == {a, b} | common

    def _merge(self, a: int, b: int) -> None:
        """b becomes a; faces that have both, or now lie on each other, go."""
        seen = {frozenset(self._rows[row]): row for row in self._around[a]}
        for row in sorted(self._around.pop(b)):
            corners = self._rows[row]
            if a in corners:
                self._drop(row, b)
                continue
            moved = (_with(corners[0], b, a), _with(corners[1], b, a), _with(corners[2], b, a))
            twin = seen.get(frozenset(moved))
            if twin is not None:
                self._drop(row, b)
                self._drop(twin, b)
                continue
            self._rows[row] = moved
            self._around[a].add(row)

    def _drop(self, row: int, gone: int) -> None:
        for corner in self._rows.pop(row):
            if corner != gone:
                self._around[corner].discard(row)


def _with(corner: int, old: int, new: int) -> int:
    return new if corner == old else corner


def _renamed(name: dict[int, int], vertex: int) -> int:
    while vertex in name:
        vertex = name[vertex]
    return vertex


def _apart(
    vertices: NDArray[np.float64], stars: _Stars, pairs: list[tuple[int, int]], reach: float
) -> NDArray[np.float64]:
    """The vertices with those of the pairs moved along their surface, each by another length."""
    if not pairs:
        return vertices
    chosen, flat = np.unique(np.array(pairs), return_inverse=True)
    group = parts(flat.reshape(-1, 2), len(chosen))
    result = vertices.copy()
    rank: Counter[int] = Counter()
    for vertex, place in zip(chosen.tolist(), group.tolist(), strict=True):
        around = vertices[list(stars.neighbours(vertex))] - vertices[vertex]
        length = np.linalg.norm(around, axis=1)
        farthest = int(length.argmax())
        step = min(rank[place] * reach, 0.5 * length[farthest])
        result[vertex] += step * around[farthest] / max(length[farthest], 1e-30)
        rank[place] += 1
    return result
