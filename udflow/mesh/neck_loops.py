"""Short closed ways around a neck of a surface, found by compiled loops.

In a ball of the surface around a vertex the shortest ways that cannot be drawn together are found
as Erickson and Whittlesey (2005) find them on closed surfaces: a tree of shortest paths, a greatest
spanning tree of the faces that does not cross it, and the edges that lie in neither.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from udflow.compiled import Array, compiled
from udflow.mesh.ball_loops import apart, area_of, euler, faces_inside, grown, joined

NONE, NECK, HANDLE = 0, 1, 2  # what a ball holds


@compiled
def search(
    start: int, stop: int, seeds: Array, reach: Array, vertices: Array, faces: Array,
    first: Array, around: Array, beyond: Array, kind: Array, way: Array, size: Array,
) -> None:  # fmt: skip
    """Looks into the balls around seeds start..stop.

    Args:
        start, stop: rows.
        seeds: (n,) vertices.
        reach: (n,) radius of the balls, along edges.
        vertices: (v, 3).
        faces: (f, 3) of a manifold.
        first: (v + 1,) vertex i is a corner of the faces around[first[i] : first[i + 1]].
        around: (3f,) faces.
        beyond: (f, 3) face behind the side from each corner to the next, or -1.
        kind: (n,) NONE, NECK or HANDLE, filled in.
        way: (n, m) vertices of the shortest way, filled in.
        size: (n,) how many they are, filled in.
    """
    distance = np.full(len(vertices), np.inf)
    parent = np.full(len(vertices), -1)
    local = np.full(len(faces), -1)
    rim = np.full(len(vertices), -1)
    for i in range(start, stop):
        ball = grown(seeds[i : i + 1], reach[i], vertices, faces, first, around, distance, parent)
        inside = faces_inside(ball, reach[i], first, around, distance, local)
        if euler(inside, ball, faces, first, around, beyond, local) < 1:
            found, u, w = _bottleneck(inside, vertices, faces, beyond, distance, parent, local, rim)
            if found != NONE:
                size[i] = joined(u, w, parent, way[i])
                kind[i] = found if size[i] >= 3 else NONE
        for f in inside:
            local[f] = -1
        for v in ball:
            distance[v], parent[v] = np.inf, -1


@compiled
def flare(
    start: int, stop: int, way: Array, size: Array, reach: Array, vertices: Array, faces: Array,
    first: Array, around: Array, beyond: Array, real: int, area: Array, meet: Array,
) -> None:  # fmt: skip
    """Measures how much surface lies near both sides of ways.

    Args:
        start, stop, way, size, vertices, faces, first, around, beyond: see `search`.
        reach: (n,) distance from the way, along edges.
        real: vertices from this one on are the centres of caps, whose area does not count.
        area: (n, 2) filled in.
        meet: (n,) bool, the sides are one; filled in, with half of the area for each.
    """
    distance = np.full(len(vertices), np.inf)
    parent = np.full(len(vertices), -1)
    local = np.full(len(faces), -1)
    place = np.full(len(vertices), -1)
    for i in range(start, stop):
        loop = way[i, : size[i]]
        for k in range(len(loop)):
            place[loop[k]] = k
        ball = grown(loop, reach[i], vertices, faces, first, around, distance, parent)
        inside = faces_inside(ball, reach[i], first, around, distance, local)
        side = _sides(inside, len(loop), faces, beyond, local, place)
        for k in range(len(inside)):
            corner = faces[inside[k]]
            if side[k] < 2 and max(corner) < real:
                area[i, side[k]] += area_of(vertices, corner)
        meet[i] = _meeting(inside, side, len(loop), faces, beyond, local, place)
        for f in inside:
            local[f] = -1
        for v in ball:
            distance[v], parent[v] = np.inf, -1
        for v in loop:
            place[v] = -1


@compiled
def _root(of: Array, node: int) -> int:
    """The representative of a node in a forest of joined nodes."""
    while of[node] != node:
        of[node] = of[of[node]]
        node = of[node]
    return node


@compiled
def _bottleneck(
    inside: Any, vertices: Array, faces: Array, beyond: Array, distance: Array, parent: Array,
    local: Array, rim: Array,
) -> Any:  # fmt: skip
    """What the shortest way that cannot be drawn together is, and the edge that closes it."""
    sides, length, borders = _open_sides(
        inside, vertices, faces, beyond, distance, parent, local, rim
    )
    total = len(inside) + borders
    of, at_border = np.arange(total), np.zeros(total, dtype=np.bool_)
    at_border[len(inside) :] = True
    kind, u, w = NONE, -1, -1
    for k in np.argsort(-length, kind="mergesort"):  # the longest first
        one, two = _root(of, sides[k, 0]), _root(of, sides[k, 1])
        if one == two or (at_border[one] and at_border[two]):
            kind, u, w = HANDLE if one == two else NECK, sides[k, 2], sides[k, 3]
        if one != two:
            of[one] = two
            at_border[two] |= at_border[one]
    return kind, u, w


@compiled
def _open_sides(
    inside: Any, vertices: Array, faces: Array, beyond: Array, distance: Array, parent: Array,
    local: Array, rim: Array,
) -> Any:  # fmt: skip
    """(e, 4) what lies on both sides of each edge that is not in the tree, and its ends; the
    length of the way through it; and how many borders there are, which count as faces."""
    count = len(inside)
    of, ends = np.arange(3 * count), np.empty((3 * count, 2), dtype=np.int64)
    used = 0
    for f in inside:  # number the vertices of borders, and join those of each
        for c in range(3):
            if beyond[f, c] >= 0 and local[beyond[f, c]] >= 0:
                continue
            for end in (faces[f, c], faces[f, (c + 1) % 3]):
                if rim[end] < 0:
                    rim[end] = used
                    ends[used, 0] = end
                    used += 1
            of[_root(of, rim[faces[f, c]])] = _root(of, rim[faces[f, (c + 1) % 3]])
    number, borders = np.full(used + 1, -1), 0
    for node in range(used):
        if of[node] == node:
            number[node] = borders
            borders += 1
    sides, length, found = np.empty((3 * count, 4), dtype=np.int64), np.empty(3 * count), 0
    for f in inside:
        for c in range(3):
            u, w, g = faces[f, c], faces[f, (c + 1) % 3], beyond[f, c]
            across = local[g] if g >= 0 else -1
            if parent[u] == w or parent[w] == u or (across >= 0 and across < local[f]):
                continue
            sides[found, 0], sides[found, 2], sides[found, 3] = local[f], u, w
            sides[found, 1] = across if across >= 0 else count + number[_root(of, rim[u])]
            length[found] = distance[u] + distance[w] + apart(vertices, u, w)
            found += 1
    for node in range(used):
        rim[ends[node, 0]] = -1
    return sides[:found], length[:found], borders


@compiled
def _on_way(u: int, w: int, count: int, place: Array) -> int:
    """1 if the way goes from u to w, -1 if from w to u, else 0."""
    one, two = place[u], place[w]
    if one < 0 or two < 0:
        return 0
    if (one + 1) % count == two:
        return 1
    return -1 if (two + 1) % count == one else 0


@compiled
def _sides(
    inside: Any, count: int, faces: Array, beyond: Array, local: Array, place: Array
) -> Array:
    """Which side of a way faces lie on, 0 or 1, by whichever reaches them first; 2 for neither."""
    side = np.full(len(inside), 2)
    stack = [inside[0] for _ in range(0)]
    for f in inside:
        for c in range(3):
            along = _on_way(faces[f, c], faces[f, (c + 1) % 3], count, place)
            if along != 0 and side[local[f]] == 2:
                side[local[f]] = 0 if along > 0 else 1
                stack.append(f)
    while len(stack) > 0:
        f = stack.pop()
        for c in range(3):
            g = beyond[f, c]
            if g < 0 or local[g] < 0 or side[local[g]] < 2:
                continue
            if _on_way(faces[f, c], faces[f, (c + 1) % 3], count, place) == 0:
                side[local[g]] = side[local[f]]
                stack.append(g)
    return side


@compiled
def _meeting(
    inside: Any, side: Array, count: int, faces: Array, beyond: Array, local: Array, place: Array
) -> bool:
    """Whether the two sides of a way touch elsewhere than on it."""
    for f in inside:
        for c in range(3):
            g = beyond[f, c]
            if g < 0 or local[g] < 0 or side[local[g]] == side[local[f]]:
                continue
            if _on_way(faces[f, c], faces[f, (c + 1) % 3], count, place) == 0:
                return True
    return False
