"""Sides of polygons sorted by the edge they lie on, as a compiled loop: see `topology.edges_of`."""

from __future__ import annotations

import numpy as np

from udflow.compiled import Array, compiled

_MANY = 64  # sides at a vertex from which on they are sorted in no time that grows with the square


@compiled
def sort_sides(faces: Array, pile: Array, sides: Array, ends: Array, first: Array) -> int:
    """Fills in the edges of polygons, and tells how many there are.

    Sides are dealt out by the lower of their vertices and then sorted by the higher one, so that
    those of an edge follow each other in their order.

    Args:
        faces: (f, k) int64.
        pile: (v + 1,) int64 zeros, v more than any vertex; of use inside.
        sides: (k f,) int64, filled in.
        ends: (k f, 2) int64, the first rows filled in, one per edge.
        first: (k f + 1,) int64, filled in likewise, and one more.
    """
    count, k = faces.shape
    for f in range(count):
        for c in range(k):
            pile[min(faces[f, c], faces[f, (c + 1) % k]) + 1] += 1
    for v in range(1, len(pile)):
        pile[v] += pile[v - 1]
    higher = np.empty(k * count, np.int64)
    for f in range(count):
        for c in range(k):
            one, two = faces[f, c], faces[f, (c + 1) % k]
            low = min(one, two)
            sides[pile[low]], higher[pile[low]] = k * f + c, max(one, two)
            pile[low] += 1
    edges, start = 0, 0
    for v in range(len(pile) - 1):
        stop = pile[v]
        _sort(higher[start:stop], sides[start:stop])
        for i in range(start, stop):
            if i == start or higher[i] != higher[i - 1]:
                ends[edges, 0], ends[edges, 1], first[edges] = v, higher[i], i
                edges += 1
        start = stop
    first[edges] = start
    return edges


@compiled
def deal_out(corners: Array, first: Array, around: Array, k: int) -> None:
    """Fills in the polygons at each vertex, in their order.

    Args:
        corners: (k f,) int64 vertices of polygons with k corners.
        first: (v + 1,) int64 zeros, filled in: vertex i owns around[first[i] : first[i + 1]].
        around: (k f,) int64, filled in; a polygon comes as often as it has the vertex.
        k: corners of a polygon.
    """
    for vertex in corners:
        first[vertex] += 1
    total = 0
    for v in range(len(first)):
        first[v], total = total, total + first[v]
    for i in range(len(corners)):
        around[first[corners[i]]] = i // k
        first[corners[i]] += 1
    for v in range(len(first) - 1, 0, -1):
        first[v] = first[v - 1]
    first[0] = 0


@compiled
def _sort(keys: Array, values: Array) -> None:
    """Sorts values by their keys, and these; equal ones stay in their order."""
    if len(keys) > _MANY:
        order = np.argsort(keys, kind="mergesort")
        keys[:], values[:] = keys[order], values[order]
        return
    for i in range(1, len(keys)):
        key, value, j = keys[i], values[i], i
        while j > 0 and keys[j - 1] > key:
            keys[j], values[j] = keys[j - 1], values[j - 1]
            j -= 1
        keys[j], values[j] = key, value
