"""Balls on a surface, grown along its edges by compiled loops."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from udflow.compiled import Array, compiled

MOST = 96  # vertices of a way


@compiled
def grown(
    seeds: Array, reach: float, vertices: Array, faces: Array, first: Array, around: Array,
    distance: Array, parent: Array,
) -> Any:  # fmt: skip
    """The vertices within reach of the seeds; their distances and parents are filled in.

    Vertices beyond it get a distance as well, and are listed too.
    """
    ball = [seeds[0] for _ in range(0)]
    heap = [(0.0, seeds[0]) for _ in range(0)]
    for s in seeds:
        distance[s] = 0.0
        ball.append(s)
        heapq.heappush(heap, (0.0, s))
    while len(heap) > 0:
        here, v = heapq.heappop(heap)
        if here > distance[v] or here > reach:
            continue
        for k in range(first[v], first[v + 1]):
            for c in range(3):
                w = faces[around[k], c]
                there = here + apart(vertices, v, w)
                if there < distance[w]:
                    if distance[w] == np.inf:
                        ball.append(w)
                    distance[w], parent[w] = there, v
                    if there <= reach:
                        heapq.heappush(heap, (there, w))
    return ball


@compiled
def faces_inside(
    ball: Any, reach: float, first: Array, around: Array, distance: Array, local: Array
) -> Any:
    """Faces with a corner within reach; `local` becomes their number in this list.

    So the tree of shortest paths runs along sides of these faces.
    """
    inside = [around[0] for _ in range(0)]
    for v in ball:
        if distance[v] > reach:
            continue
        for k in range(first[v], first[v + 1]):
            if local[around[k]] < 0:
                local[around[k]] = len(inside)
                inside.append(around[k])
    return inside


@compiled
def euler(
    inside: Any, ball: Any, faces: Array, first: Array, around: Array, beyond: Array, local: Array
) -> int:
    """Vertices - edges + faces of some faces; 1 where there are none."""
    if len(inside) == 0:
        return 1
    corners, doubled = 0, 0
    for v in ball:
        for k in range(first[v], first[v + 1]):
            if local[around[k]] >= 0:
                corners += 1
                break
    for f in inside:
        for c in range(3):
            doubled += 1 if beyond[f, c] >= 0 and local[beyond[f, c]] >= 0 else 2
    return corners - doubled // 2 + len(inside)


@compiled
def joined(u: int, w: int, parent: Array, way: Array) -> int:
    """Writes down the ways from both ends of an edge to where they meet; how many vertices, or 0
    if they are too many."""
    depth_u, depth_w = _depth(u, parent), _depth(w, parent)
    one, two = u, w
    while one != two:
        if depth_u >= depth_w:
            one, depth_u = parent[one], depth_u - 1
        else:
            two, depth_w = parent[two], depth_w - 1
    steps = 0
    while u != one and steps < MOST:
        way[steps] = u
        u, steps = parent[u], steps + 1
    if steps < MOST:
        way[steps] = one
    steps += 1
    last = steps
    while w != one and last < MOST:
        way[last] = w
        w, last = parent[w], last + 1
    if last >= MOST:
        return 0
    way[steps:last] = way[steps:last][::-1].copy()
    return last


@compiled
def _depth(node: int, parent: Array) -> int:
    """Steps from a node to the root of its tree."""
    depth = 0
    while parent[node] >= 0:
        node, depth = parent[node], depth + 1
    return depth


@compiled
def apart(vertices: Array, u: int, w: int) -> float:
    """Distance of two vertices."""
    x, y, z = (
        vertices[u, 0] - vertices[w, 0],
        vertices[u, 1] - vertices[w, 1],
        vertices[u, 2] - vertices[w, 2],
    )
    return (x * x + y * y + z * z) ** 0.5


@compiled
def area_of(vertices: Array, corner: Array) -> float:
    """Area of a triangle, from the lengths of its sides."""
    a = apart(vertices, corner[0], corner[1])
    b = apart(vertices, corner[1], corner[2])
    c = apart(vertices, corner[2], corner[0])
    s = 0.5 * (a + b + c)
    return max(s * (s - a) * (s - b) * (s - c), 0.0) ** 0.5
