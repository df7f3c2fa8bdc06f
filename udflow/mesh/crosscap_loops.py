"""Short closed ways over faces that come back turned over, found by compiled loops."""

from __future__ import annotations

import heapq

import numpy as np

from udflow.compiled import Array, compiled

MOST = 256  # faces of a way


@compiled
def turning_ways(
    start: int, stop: int, seeds: Array, longest: float, centres: Array, beyond: Array,
    turned: Array, way: Array, size: Array, length: Array,
) -> None:  # fmt: skip
    """Finds the shortest turning way through each of the faces seeds[start:stop].

    A step goes from face to face across a side, from centre to centre. Each face is there twice,
    as it is and reversed; a way turns if it leads from one to the other.

    Args:
        start, stop: rows.
        seeds: (n,) faces.
        longest: of the ways that are looked for.
        centres: (f, 3) of the faces.
        beyond: (f, 3) face behind the side from each corner to the next, or -1.
        turned: (f, 3) whether that face runs along the side in the same direction.
        way: (n, MOST) faces, filled in.
        size: (n,) how many they are, filled in; 0 where there is no way so short.
        length: (n,) filled in.
    """
    distance = np.full(2 * len(centres), np.inf)
    parent = np.full(2 * len(centres), -1)
    for i in range(start, stop):
        first, last = 2 * seeds[i], 2 * seeds[i] + 1
        seen = [first]
        heap = [(0.0, first)]
        distance[first] = 0.0
        while len(heap) > 0:
            here, node = heapq.heappop(heap)
            if node == last:
                break
            if here > distance[node]:
                continue
            for c in range(3):
                across = beyond[node // 2, c]
                if across < 0:
                    continue
                there = here + _apart(centres, node // 2, across)
                if there + _apart(centres, across, seeds[i]) > longest:
                    continue
                other = 2 * across + ((node % 2) ^ (1 if turned[node // 2, c] else 0))
                if there < distance[other]:
                    if distance[other] == np.inf:
                        seen.append(other)
                    distance[other], parent[other] = there, node
                    heapq.heappush(heap, (there, other))
        length[i] = distance[last]
        node = last
        while distance[last] < np.inf and node != first and size[i] < MOST:
            way[i, size[i]] = node // 2
            size[i] += 1
            node = parent[node]
        if node != first:
            size[i] = 0
        for node in seen:
            distance[node], parent[node] = np.inf, -1


@compiled
def _apart(points: Array, one: int, two: int) -> float:
    """Distance of two points."""
    x = points[one, 0] - points[two, 0]
    y = points[one, 1] - points[two, 1]
    z = points[one, 2] - points[two, 2]
    return (x * x + y * y + z * z) ** 0.5
