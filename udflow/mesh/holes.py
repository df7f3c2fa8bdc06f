"""Closing holes that are failures of extraction, not ends of the data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.mesh.support import support
from udflow.mesh.topology import edges_of, parts, side_ends, vertex_normals

ALWAYS = 8  # edges of a loop that is smaller than any hole the samples could show
LARGEST = 64  # edges of a loop that may be closed where the data goes on around it
DATA_GOES_ON = -0.4  # mean overshoot on such a loop, in spacings
_FAN = 10  # vertices around one centre at most; longer loops get rings first

Project = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def closed(mesh: Mesh, samples: NDArray[np.float64], voxel: float, project: Project) -> Mesh:
    """The mesh with small loops closed, and longer ones where the data goes on around them.

    Args:
        mesh: oriented triangles.
        samples: (m, 3) the data.
        voxel: samples nearer to each other than this are taken as one.
        project: moves (n, 3) new vertices onto the surface.
    """
    loops = [loop for loop in border_loops(mesh.faces) if len(loop) <= LARGEST]
    if not loops:
        return mesh
    chosen = _failures(mesh, loops, samples, voxel)
    if not chosen:
        return mesh
    points: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    count = len(mesh.vertices)
    for loop in chosen:
        new_points, new_faces = _patch(mesh.vertices[loop], loop, count)
        points.append(new_points)
        faces.append(new_faces)
        count += len(new_points)
    added = np.concatenate(points)
    return Mesh(
        np.concatenate([mesh.vertices, project(added) if len(added) else added]),
        np.concatenate([mesh.faces, *faces]),
    )


def border_loops(faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Closed borders as vertices in the order of the missing faces; only loops that pass every
    vertex once."""
    sides = edges_of(faces).sides_where(1)[:, 0]
    end, start = side_ends(faces, sides)  # a missing face runs against its neighbour
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
    mesh: Mesh, loops: list[NDArray[np.int64]], samples: NDArray[np.float64], voxel: float
) -> list[NDArray[np.int64]]:
    vertices = np.concatenate(loops)
    normals = vertex_normals(mesh)[vertices]
    found = support(mesh.vertices[vertices], normals, samples, voxel).overshoot
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
