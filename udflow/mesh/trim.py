"""Cutting the surface where the data ends: rims along the contour of the overshoot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.draft import Draft, Project
from udflow.mesh.support import ALLOWED_GAP, SampleSet, Support, first_of_cluster, support
from udflow.mesh.topology import face_normals, parts, side_pairs, with_any

SEED = 0.25  # spacings beyond the data that a region must reach to be cut
SMALLEST_HOLE = 3.0  # squared spacings: smaller gaps inside a surface are chance, not holes
SURE_GAP = 2.0  # spacings to the nearest sample that random samples leave nowhere
MOST_PASSES = 40
_KEPT = -0.5  # overshoot given to islands that stay
_NEAR = -1.0  # overshoot above which faces take part
_STRIDE = 0.5  # spacings between the balls that a hole is filled with
_RIM = 0.45  # spacings between a rim and the samples at it
_SNAP = 0.25  # a cut nearer to a vertex than this part of an edge moves the vertex instead


def trimmed(draft: Draft, samples: SampleSet, voxel: float, project: Project) -> Draft:
    """The mesh without what lies beyond the data.

    Regions beyond the data are cut off if they reach the border of the mesh or are large enough
    to be a hole; islands of chance on closed surfaces stay.

    Args:
        draft: oriented triangles.
        samples: the data.
        voxel: of the lattice, about the length of an edge.
        project: moves (n, 3) points onto the surface; cut vertices lie on chords of it.
    """
    found = support(samples, draft.vertices, draft.faces)
    near = draft.faces[with_any(draft.faces, found.overshoot > _NEAR)]
    beyond = _opened(draft.vertices, _without_islands(draft, near, found), found)
    if not (beyond > 0).any():
        return draft
    draft, moved = cut(draft, _smoothed(near, beyond, _passes(samples.spacing / voxel)))
    vertices = draft.vertices.copy()
    vertices[moved] = project(vertices[moved])
    return replace(draft, vertices=vertices)


def _without_islands(draft: Draft, faces: NDArray[np.int64], found: Support) -> NDArray[np.float64]:
    """The overshoot, lowered on the regions that shall stay.

    Args:
        draft: the mesh.
        faces: those of its faces that may take part in a region.
        found: overshoot and spacing at the vertices.
    """
    beyond = found.overshoot.copy()
    inside = np.flatnonzero(beyond > 0)
    pairs = side_pairs(faces)
    region = parts(pairs[(beyond[pairs] > 0).all(axis=1)], len(beyond))[inside]
    count = int(region.max(initial=-1)) + 1
    at_border = np.zeros(count, dtype=bool)
    at_border[region[draft.loose[inside]]] = True
    peak = np.full(count, -np.inf)
    np.maximum.at(peak, region, beyond[inside])
    sixth = np.repeat(np.linalg.norm(face_normals(draft.vertices, faces), axis=1) / 6, 3)
    area = np.bincount(faces.reshape(-1), sixth, minlength=len(beyond))[inside]
    size = np.bincount(region, area / np.maximum(found.spacing[inside], 1e-12) ** 2, count)
    deepest = np.zeros(count)
    np.maximum.at(deepest, region, found.gap[inside])
    goes = (peak > SEED) & (at_border | (size > SMALLEST_HOLE) | (deepest > SURE_GAP))
    beyond[inside[~goes[region]]] = _KEPT
    return beyond


def _opened(
    vertices: NDArray[np.float64], beyond: NDArray[np.float64], found: Support
) -> NDArray[np.float64]:
    """The overshoot, raised in all of the holes that go: up to the samples around them.

    Inside a hole samples lie on all sides, so that only its middle is seen to lie beyond the data.
    From there it reaches as far as balls without samples do.
    """
    middle = np.flatnonzero((beyond > 0) & (found.gap > ALLOWED_GAP))
    if len(middle) == 0:
        return beyond
    depth = (found.gap * found.spacing)[middle]
    order = middle[np.argsort(-depth, kind="stable")]
    deepest = order[first_of_cluster(vertices[order], _STRIDE * found.spacing[middle].min())[0]]
    depth = (found.gap * found.spacing)[deepest]
    balls = cKDTree(vertices).query_ball_point(vertices[deepest], depth, workers=2)
    of = np.repeat(np.arange(len(deepest)), [len(ball) for ball in balls])
    inside = np.concatenate([np.asarray(ball, dtype=np.int64) for ball in balls])
    way = np.linalg.norm(vertices[inside] - vertices[deepest[of]], axis=1)
    raised = beyond.copy()
    np.maximum.at(raised, inside, (depth[of] - way) / found.spacing[deepest[of]] - _RIM)
    return raised


def _passes(edges_per_spacing: float) -> int:
    """Averages with neighbours that reach about as far as neighbouring samples."""
    return min(MOST_PASSES, math.ceil(3 + 1.5 * edges_per_spacing**2))


def _smoothed(
    faces: NDArray[np.int64], values: NDArray[np.float64], passes: int
) -> NDArray[np.float64]:
    """Values at vertices after a few averages with their neighbours: the rim is no rougher than
    the samples require."""
    pairs = side_pairs(faces)
    used, flat = np.unique(pairs, return_inverse=True)
    start, end = flat.reshape(-1, 2).T
    degree = np.bincount(start, minlength=len(used))
    local = values[used]
    for _ in range(passes):
        around = np.bincount(start, local[end], minlength=len(used)) / degree
        local = 0.5 * (local + around)
    result = values.copy()
    result[used] = local
    return result


def cut(draft: Draft, level: NDArray[np.float64]) -> tuple[Draft, NDArray[np.int64]]:
    """The part of a mesh where a function on its vertices is below 0, cut along its contour, and
    the vertices on that contour.

    Args:
        draft: triangles.
        level: (v,) values, linear inside triangles.
    """
    vertices, level = _snapped(draft, level)
    above, below = with_any(draft.faces, level > 0), with_any(draft.faces, level < 0)
    whole, split = below & ~above, below & above
    points, pieces = _pieces(vertices, level, draft.faces[split])
    rim = np.concatenate([level == 0, np.ones(len(points), dtype=bool)])
    kept = np.concatenate([draft.faces[whole], pieces])
    remaining = Draft(vertices, draft.faces, draft.loose | (level == 0)).replaced(points, kept)
    used = np.zeros(len(rim), dtype=bool)
    used[kept] = True
    return remaining.compacted(), np.flatnonzero(rim[used])


def _snapped(
    draft: Draft, level: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vertices close to the contour moved onto it, so that no slivers are cut."""
    pairs = side_pairs(draft.faces[with_any(draft.faces, level > 0)])
    start, end = np.concatenate([pairs, pairs[:, ::-1]]).T
    crossing = level[start] * level[end] < 0
    start, end = start[crossing], end[crossing]
    along = level[start] / (level[start] - level[end])
    order = np.lexsort((end, along, start))
    start, end, along = start[order], end[order], along[order]
    first = np.ones(len(start), dtype=bool)
    first[1:] = start[1:] != start[:-1]
    chosen = first & (along < _SNAP)
    start, end, along = start[chosen], end[chosen], along[chosen, None]
    vertices, level = draft.vertices.copy(), level.copy()
    vertices[start] = draft.vertices[start] * (1 - along) + draft.vertices[end] * along
    level[start] = 0.0
    return vertices, level


def _pieces(
    vertices: NDArray[np.float64], level: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """New vertices on cut edges, and what is left of (k, 3) faces that are cut."""
    sign = np.sign(level[faces]).astype(np.int64)
    pairs = side_pairs(faces)
    low, high = np.sort(pairs, axis=1).T
    is_cut = level[low] * level[high] < 0
    edge = low * len(vertices) + high
    cut_edges, first = np.unique(edge[is_cut], return_index=True)
    low, high = low[is_cut][first], high[is_cut][first]
    along = (level[low] / (level[low] - level[high]))[:, None]
    points = vertices[low] * (1 - along) + vertices[high] * along
    # per side the number of its cut, meaningless where the side is not cut
    new = (len(vertices) + np.searchsorted(cut_edges, edge)).reshape(-1, 3)

    pieces = []
    for turn in range(3):
        a, b, c = (np.roll(sign, -turn, axis=1)[:, i] for i in range(3))
        face, side = np.roll(faces, -turn, axis=1), np.roll(new, -turn, axis=1)
        tip = (a < 0) & (b > 0) & (c > 0)
        pieces.append(np.stack([face[tip, 0], side[tip, 0], side[tip, 2]], axis=1))
        rest = (a > 0) & (b < 0) & (c < 0)
        pieces.append(np.stack([face[rest, 1], face[rest, 2], side[rest, 2]], axis=1))
        pieces.append(np.stack([face[rest, 1], side[rest, 2], side[rest, 0]], axis=1))
        falling = (a < 0) & (b == 0) & (c > 0)
        pieces.append(np.stack([face[falling, 0], face[falling, 1], side[falling, 2]], axis=1))
        rising = (a < 0) & (b > 0) & (c == 0)
        pieces.append(np.stack([face[rising, 0], side[rising, 0], face[rising, 2]], axis=1))
    return points, np.concatenate(pieces)
