"""How well the samples support points of the surface: where does the data end?

A field has a surface beyond the rim of its data. Beyond a rim all nearest samples lie on one
side, so the measure is by how much a point overshoots the outermost of them, in the direction
away from their centroid and in units of the local sample spacing. It grows linearly across a rim,
is about 0 on it, and on a random sample of a closed surface stays below 0 but for tiny islands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.topology import face_normals, vertex_normals, with_any

NEIGHBOURS = (8, 16, 24)
# Overshoot that counts as the end of the data for each number of neighbours: few neighbours see
# narrow holes but are noisy, many place a rim well.
ALLOWED = (1.0, 0.6, 0.35)
ALLOWED_GAP = 1.6  # spacings to the nearest sample: inside a hole samples lie on all sides
_COARSE = 1.0  # spacings a side: clusters of vertices that are looked at together at first
_SAFE = -0.8  # overshoot of one vertex below which its cluster is surely supported

Points = NDArray[np.float64]


@dataclass(frozen=True)
class SampleSet:
    """The data, with a tree for look-ups.

    Attributes:
        points: (m, 3) float64 samples, no two in one voxel, which evens out their density.
        tree: over these points.
        spacing: median distance of neighbouring points.
    """

    points: Points
    tree: cKDTree
    spacing: float

    @cached_property
    def around(self) -> Points:
        """(m,) distance of neighbouring points around each, from the circle that holds as many as
        are ever asked for."""
        count = min(NEIGHBOURS[-1] + 1, len(self.points))
        radius = self.tree.query(self.points, k=[count], workers=2)[0][:, 0]
        spacing: Points = np.maximum(radius * np.sqrt(np.pi / count), 1e-12)
        return spacing

    @classmethod
    def of(cls, samples: Points, voxel: float) -> SampleSet:
        """The set of (n, 3) samples, one for each occupied cube as wide as a voxel."""
        points = samples[first_of_cluster(samples, voxel)[0]]
        tree = cKDTree(points)
        count = min(9, len(points))
        radius = tree.query(points[:: max(1, len(points) // 2000)], k=[count])[0]
        return cls(points, tree, float(np.median(radius) * np.sqrt(np.pi / count)))


@dataclass(frozen=True)
class Support:
    """What the samples say about each vertex.

    Attributes:
        overshoot: (v,) how far it lies beyond the samples, in spacings; above 0 the data has
            ended.
        gap: (v,) distance to the nearest sample, in spacings, 0 where it was not measured.
        spacing: (v,) local distance of neighbouring samples, 0 where it was not measured.
    """

    overshoot: Points
    gap: Points
    spacing: Points


def support(samples: SampleSet, vertices: Points, faces: NDArray[np.int64]) -> Support:
    """How the vertices of oriented triangles lie with respect to the samples.

    Args:
        samples: the data.
        vertices: (v, 3) points of the surface.
        faces: (f, 3) triangles; normals decide what counts as distance along the surface.

    Vertices well inside the data are not measured one by one; they get the value of a neighbour.
    """
    leader, cluster = first_of_cluster(vertices, _COARSE * samples.spacing)
    any_face = np.zeros(len(vertices), dtype=np.int64)
    any_face[faces] = np.arange(len(faces))[:, None]
    normals = _unit(face_normals(vertices, faces[any_face[leader]]))
    rough = _measured(samples, vertices[leader], normals, NEIGHBOURS[1:2], (0.0,))

    beyond = rough.overshoot[cluster]
    gap, local = np.zeros(len(vertices)), np.zeros(len(vertices))
    close = np.flatnonzero(beyond > _SAFE)
    fine = support_at(samples, vertices, faces, close)
    beyond[close], gap[close], local[close] = fine.overshoot, fine.gap, fine.spacing
    return Support(beyond, gap, local)


def support_at(
    samples: SampleSet, vertices: Points, faces: NDArray[np.int64], chosen: NDArray[np.int64]
) -> Support:
    """`support` of (n,) chosen vertices alone, each measured by itself."""
    around = np.zeros(len(vertices), dtype=bool)
    around[chosen] = True
    normals = vertex_normals(vertices, faces[with_any(faces, around)])[chosen]
    return _measured(samples, vertices[chosen], normals, NEIGHBOURS, ALLOWED)


def _unit(vectors: Points) -> Points:
    unit: Points = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
    return unit


def _measured(
    samples: SampleSet,
    points: Points,
    normals: Points,
    counts: tuple[int, ...],
    allowed: tuple[float, ...],
) -> Support:
    """The largest excess over what is allowed, for several numbers of neighbours.

    The spacing is that of the samples: around a point inside a hole there are none.
    """
    most = min(counts[-1], samples.tree.n)
    if len(points) == 0:
        return Support(np.zeros(0), np.zeros(0), np.zeros(0))
    distance, index = samples.tree.query(points, k=np.arange(1, most + 1), workers=2)
    spacing = np.median(samples.around[index], axis=1)
    gap = distance[:, 0] / spacing
    offset = samples.points[index] - points[:, None]
    offset -= np.einsum("nki,ni->nk", offset, normals)[..., None] * normals[:, None]
    result = gap - ALLOWED_GAP
    for count, limit in zip(counts, allowed, strict=True):
        near = offset[:, :count]
        away = -near.mean(axis=1)
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        beyond = -np.einsum("nki,ni->nk", near, away).max(axis=1)
        np.maximum(result, beyond / spacing - limit, out=result)
    return Support(result, gap, spacing)


def first_of_cluster(points: Points, width: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One point of each occupied cube of a width, and for each point its cube."""
    cell = np.floor((points - points.min(axis=0)) / width).astype(np.int64)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, cluster = np.unique(key, return_index=True, return_inverse=True)
    return first, cluster.reshape(-1)
