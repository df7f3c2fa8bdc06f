"""A mesh made ready for measuring: welded, without doubled or empty faces, and its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from udflow.errors import EmptySurface
from udflow.mesh.load import weld
from udflow.mesh.mesh import Mesh


@dataclass(frozen=True)
class Samples:
    """points (n, 3) on a surface and the unit normals (n, 3) of their faces."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]


def bounds(mesh: Mesh) -> tuple[NDArray[np.float64], float]:
    """Centre (3,) and largest extent of the box around the vertices that faces use.

    Raises:
        EmptySurface: the mesh has no face, no extent, or a vertex that is not finite.
    """
    used = mesh.vertices[np.unique(mesh.faces)]
    if len(used) == 0:
        raise EmptySurface("the mesh has no faces, so there is nothing to measure")
    if not np.isfinite(used).all():
        raise EmptySurface("the mesh has vertices that are not finite numbers; repair it first")
    low, high = used.min(axis=0), used.max(axis=0)
    extent = float((high - low).max())
    if extent == 0.0:
        raise EmptySurface("all vertices of the mesh lie on one point, so it has no surface")
    return 0.5 * (low + high), extent


def prepare(mesh: Mesh, centre: NDArray[np.float64], scale: float) -> Mesh:
    """The mesh moved by (x - centre) / scale, welded, each face once.

    Doubled faces break every sampling floor (twice the area, the same surface), and unwelded
    vertices are borders that nobody sees.
    """
    bounds(mesh)
    vertices, faces = weld(*_used((mesh.vertices - centre) / scale, mesh.faces))
    faces = _each_face_once(faces)
    if len(faces) == 0:
        raise EmptySurface("the mesh has only faces without area, so there is nothing to measure")
    return Mesh(*_used(vertices, faces))


def _used(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Without the vertices that no face uses."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3).astype(np.int64)


def _each_face_once(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]


def face_normals(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals (f, 3), zero where a face has no area, and areas (f,)."""
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, np.finfo(float).tiny)[:, None], 0.5 * length


def sample(mesh: Mesh, count: int, generator: np.random.Generator) -> Samples:
    """`count` points spread evenly by area over the mesh."""
    normals, areas = face_normals(mesh)
    if areas.sum() == 0.0:
        raise EmptySurface("the mesh has only faces without area, so there is nothing to sample")
    face = generator.choice(len(areas), size=count, p=areas / areas.sum())
    u, v = generator.random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = mesh.vertices[mesh.faces[face]].swapaxes(0, 1)
    return Samples(points=a + u * (b - a) + v * (c - a), normals=normals[face])
