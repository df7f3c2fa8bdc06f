"""Closing holes that are failures of extraction, not ends of the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.draft import Draft, Project
from udflow.mesh.support import SampleSet, support_at
from udflow.mesh.topology import parts, side_ends

ALWAYS = 8  # edges of a loop that is smaller than any hole the samples could show
LARGEST = 64  # edges of a loop that may be closed where the data goes on around it
DATA_GOES_ON = -0.4  # mean overshoot on such a loop, in spacings
_FAN = 10  # vertices around one centre at most; longer loops get rings first


def closed(draft: Draft, samples: SampleSet, project: Project) -> Draft:
    """The mesh with small loops closed, and longer ones where the data goes on around them.

    Args:
        draft: oriented triangles.
        samples: the data.
        project: moves (n, 3) new vertices onto the surface.
    """
    loops = [loop for loop in border_loops(draft) if len(loop) <= LARGEST]
    if not loops:
        return draft
    chosen = _failures(draft, loops, samples)
    if not chosen:
        return draft
    points: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    count = len(draft.vertices)
    for loop in chosen:
        new_points, new_faces = _patch(draft.vertices[loop], loop, count)
        points.append(new_points)
        faces.append(new_faces)
        count += len(new_points)
    added = np.concatenate(points)
    added = project(added) if len(added) > 0 else added
    return draft.replaced(added, np.concatenate([draft.faces, *faces]))


def border_loops(draft: Draft) -> list[NDArray[np.int64]]:
    """Closed borders as vertices in the order of the missing faces; only loops that pass every
    vertex once."""
    sides = draft.loose_edges().sides_where(1)[:, 0]
    end, start = side_ends(draft.faces, sides)  # a missing face runs against its neighbour
    used, flat = np.unique(np.stack([start, end]), return_inverse=True)
    start, end = flat.reshape(2, -1)
    simple = (np.bincount(start, minlength=len(used)) == 1) & (
        np.bincount(end, minlength=len(used)) == 1
    )
    label = parts(np.stack([start, end], axis=1), len(used))
    broken = np.zeros(len(used), dtype=bool)
    broken[label[~simple]] = True
    following = np.zeros(len(used), dtype=np.int64)
    following[start] = end
    loops = []
    for first in np.unique(label[~broken[label]], return_index=False):
        members = np.flatnonzero(label == first)
        loops.append(used[_walk(following, int(members[0]), len(members))])
    return loops


def _walk(following: NDArray[np.int64], first: int, count: int) -> NDArray[np.int64]:
    loop = np.empty(count, dtype=np.int64)
    for i in range(count):
        loop[i] = first
        first = int(following[first])
    return loop


def _failures(
    draft: Draft, loops: list[NDArray[np.int64]], samples: SampleSet
) -> list[NDArray[np.int64]]:
    vertices = np.concatenate(loops)
    found = support_at(samples, draft.vertices, draft.faces, vertices).overshoot
    means = [part.mean() for part in np.split(found, np.cumsum([len(p) for p in loops])[:-1])]
    return [
        loop
        for loop, mean in zip(loops, means, strict=True)
        if len(loop) <= ALWAYS or mean < DATA_GOES_ON
    ]


def _patch(
    corners: NDArray[np.float64], loop: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """New vertices, numbered from `count`, and faces that fill a loop: rings of half as many
    vertices while it is long, then a fan."""
    if len(loop) == 3:
        return np.zeros((0, 3)), loop[None]
    centre = corners.mean(axis=0)
    points, faces = [], []
    while len(loop) > _FAN:
        inner = 0.5 * (_pair_means(corners) + centre)
        ring = count + np.arange(len(inner))
        faces.append(_zipped(loop, ring))
        points.append(inner)
        count += len(inner)
        corners, loop = inner, ring
    hub = np.full(len(loop), count)
    faces.append(np.stack([loop, np.roll(loop, -1), hub], axis=1))
    points.append(centre[None])
    return np.concatenate(points), np.concatenate(faces)


def _pair_means(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of corners 0 and 1, 2 and 3, ...; an odd last one stands alone."""
    even, odd = corners[0::2], corners[1::2]
    means = even.copy()
    means[: len(odd)] = 0.5 * (even[: len(odd)] + odd)
    return means


def _zipped(loop: NDArray[np.int64], ring: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces between a loop and the ring of its pairs."""
    of = ring[np.arange(len(loop)) // 2]
    following, next_of = np.roll(loop, -1), np.roll(of, -1)
    outer = np.stack([loop, following, of], axis=1)
    step = of != next_of
    inner = np.stack([following, next_of, of], axis=1)[step]
    return np.concatenate([outer, inner])
