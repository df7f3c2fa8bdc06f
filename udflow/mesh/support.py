"""How well the samples support points of the surface: where does the data end?

A field has a surface beyond the rim of its data. Beyond a rim all nearest samples lie on one
side, so the measure is by how much a point overshoots the outermost of them, in the direction
away from their centroid and in units of the local sample spacing. It grows linearly across a rim,
is about 0 on it, and on a random sample of a closed surface stays below 0 but for tiny islands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = (8, 16, 24)
# Overshoot that counts as the end of the data for each number of neighbours: few neighbours see
# narrow holes but are noisy, many place a rim well.
ALLOWED = (0.6, 0.3, 0.05)
ALLOWED_GAP = 1.6  # spacings to the nearest sample: inside a hole samples lie on all sides
_COARSE = 0.7  # spacings a side: clusters of vertices that are looked at together at first
_SAFE = -0.9  # overshoot of one vertex below which its cluster is surely supported

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Support:
    """What the samples say about each vertex.

    Attributes:
        overshoot: (v,) how far it lies beyond the samples, in spacings; above 0 the data has
            ended.
        spacing: (v,) local distance of neighbouring samples, 0 where it was not measured.
    """

    overshoot: Points
    spacing: Points


def support(vertices: Points, normals: Points, samples: Points, voxel: float) -> Support:
    """How vertices lie with respect to the samples.

    Args:
        vertices: (v, 3) points of the surface.
        normals: (v, 3) unit normals of any sign; only distances along the surface count.
        samples: (m, 3) the data.
        voxel: samples nearer to each other than this are taken as one, which evens out their
            density.

    Vertices well inside the data are not measured one by one; they get the value of a neighbour.
    """
    thinned = samples[_first_of_cluster(samples, voxel)[0]]
    tree = cKDTree(thinned)
    width = _COARSE * _spacing(tree, thinned)
    leader, cluster = _first_of_cluster(vertices, width)
    rough = _measured(tree, vertices[leader], normals[leader], NEIGHBOURS[1:2], (0.0,))
    beyond, local = rough.overshoot[cluster], np.zeros(len(vertices))
    close = np.flatnonzero(beyond > _SAFE)
    fine = _measured(tree, vertices[close], normals[close], NEIGHBOURS, ALLOWED)
    beyond[close], local[close] = fine.overshoot, fine.spacing
    return Support(beyond, local)


def _measured(
    tree: cKDTree,
    points: Points,
    normals: Points,
    counts: tuple[int, ...],
    allowed: tuple[float, ...],
) -> Support:
    """The largest excess over what is allowed, for several numbers of neighbours."""
    most = min(counts[-1], tree.n)
    if len(points) == 0:
        return Support(np.zeros(0), np.zeros(0))
    distance, index = tree.query(points, k=np.arange(1, most + 1), workers=2)
    spacing = np.maximum(distance[:, -1] * np.sqrt(np.pi / most), 1e-12)
    offset = tree.data[index] - points[:, None]
    offset -= np.einsum("nki,ni->nk", offset, normals)[..., None] * normals[:, None]
    result = distance[:, 0] / spacing - ALLOWED_GAP
    for count, limit in zip(counts, allowed, strict=True):
        near = offset[:, :count]
        away = -near.mean(axis=1)
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        beyond = -np.einsum("nki,ni->nk", near, away).max(axis=1)
        np.maximum(result, beyond / spacing - limit, out=result)
    return Support(result, spacing)


def _spacing(tree: cKDTree, points: Points) -> float:
    """Median distance of neighbouring points, from a few of them."""
    some = points[:: max(1, len(points) // 2000)]
    count = min(9, tree.n)
    radius = tree.query(some, k=[count])[0]
    return float(np.median(radius) * np.sqrt(np.pi / count))


def _first_of_cluster(points: Points, width: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """One point of each occupied cube of a width, and for each point its cube."""
    cell = np.floor((points - points.min(axis=0)) / width).astype(np.int64)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, cluster = np.unique(key, return_index=True, return_inverse=True)
    return first, cluster.reshape(-1)
