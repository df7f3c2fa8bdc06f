"""Filling closed borders: the least surface over a loop of vertices.

Dynamic programming over the chords of a loop finds its triangulation of least area without new
vertices (Barequet and Sharir 1995).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.compiled import Array, compiled

LONGEST = 256  # corners of a loop; the work grows with their cube
_CHORD = 0.02  # weight of squared chords against area: of flat fillings the one without slivers


def least_filling(
    corners: NDArray[np.float64], taken: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], float]:
    """Triangles over a loop, and their area.

    Args:
        corners: (n, 3) of the loop, 3 <= n.
        taken: (n, n) chords that must not be used, such as edges of the mesh already.

    Returns:
        (n - 2, 3) numbers of corners, in the order of the loop, and their area; no triangles and
        an infinite area if every triangulation uses a taken chord.
    """
    count = len(corners)
    if taken is None:
        taken = np.zeros((count, count), dtype=np.bool_)
    faces = np.zeros((count - 2, 3), dtype=np.int64)
    area = _least(np.ascontiguousarray(corners), np.ascontiguousarray(taken), faces)
    return faces if np.isfinite(area) else faces[:0], float(area)


@compiled
def _least(corners: Array, taken: Array, faces: Array) -> float:
    """Fills in the triangles of least area, and returns it; infinite if there are none."""
    count = len(corners)
    cost = np.zeros((count, count))
    apex = np.zeros((count, count), dtype=np.int64)
    for width in range(2, count):
        for i in range(count - width):
            j = i + width
            chord = 0.0
            for a in range(3):
                chord += (corners[i, a] - corners[j, a]) ** 2
            cost[i, j] = np.inf
            if taken[i, j] and width < count - 1:
                continue
            for k in range(i + 1, j):
                total = cost[i, k] + cost[k, j]
                if total < cost[i, j]:
                    total += _area(corners, i, k, j) + _CHORD * chord
                    if total < cost[i, j]:
                        cost[i, j] = total
                        apex[i, j] = k
    if not np.isfinite(cost[0, count - 1]):
        return np.inf
    return _collected(corners, apex, faces)


@compiled
def _collected(corners: Array, apex: Array, faces: Array) -> float:
    """Writes down the triangles under the chords of a triangulation, and returns their area."""
    stack = [(0, len(corners) - 1)]
    found, total = 0, 0.0
    while len(stack) > 0:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = apex[i, j]
        faces[found, 0], faces[found, 1], faces[found, 2] = i, k, j
        total += _area(corners, i, k, j)
        found += 1
        stack.append((i, k))
        stack.append((k, j))
    return total


@compiled
def _area(corners: Array, i: int, k: int, j: int) -> float:
    """Area of the triangle of three corners."""
    ax, ay, az = (
        corners[k, 0] - corners[i, 0],
        corners[k, 1] - corners[i, 1],
        corners[k, 2] - corners[i, 2],
    )
    bx, by, bz = (
        corners[j, 0] - corners[i, 0],
        corners[j, 1] - corners[i, 1],
        corners[j, 2] - corners[i, 2],
    )
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return 0.5 * (x * x + y * y + z * z) ** 0.5
