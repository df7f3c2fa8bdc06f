"""Cutting the surface where the data ends: rims along the contour of the overshoot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.mesh.support import Support, support
from udflow.mesh.topology import compacted, edges_of, parts, side_pairs, vertex_normals

SEED = 0.25  # spacings beyond the data that a region must reach to be cut
SMALLEST_HOLE = 3.0  # squared spacings: smaller gaps inside a surface are chance, not holes
SMOOTHINGS = 4
_KEPT = -0.5  # overshoot given to islands that stay
_NEAR = -1.0  # overshoot above which faces take part
_SNAP = 0.25  # a cut nearer to a vertex than this part of an edge moves the vertex instead


def trimmed(mesh: Mesh, samples: NDArray[np.float64], voxel: float) -> Mesh:
    """The mesh without what lies beyond the data.

    Regions beyond the data are cut off if they reach the border of the mesh or are large enough
    to be a hole; islands of chance on closed surfaces stay.

    Args:
        mesh: triangles.
        samples: (m, 3) the data.
        voxel: samples nearer to each other than this are taken as one.
    """
    found = support(mesh.vertices, vertex_normals(mesh), samples, voxel)
    if not (found.overshoot > 0).any():
        return mesh
    near = mesh.faces[(found.overshoot[mesh.faces] > _NEAR).any(axis=1)]
    beyond = _without_islands(mesh.vertices, near, found)
    return compacted(cut(mesh, _smoothed(near, beyond)))


def _without_islands(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], found: Support
) -> NDArray[np.float64]:
    """The overshoot, lowered on the regions that shall stay."""
    beyond = found.overshoot.copy()
    inside = np.flatnonzero(beyond > 0)
    edges = edges_of(faces)
    both = (beyond[edges.ends] > 0).all(axis=1)
    region = parts(edges.ends[both], len(beyond))
    count = len(beyond)

    at_border = np.zeros(count, dtype=bool)
    at_border[region[edges.ends[edges.count == 1]].reshape(-1)] = True
    peak = np.full(count, -np.inf)
    np.maximum.at(peak, region[inside], beyond[inside])
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.bincount(
        faces.reshape(-1), np.repeat(np.linalg.norm(normal, axis=1) / 6, 3), minlength=count
    )
    share = area[inside] / np.maximum(found.spacing[inside], 1e-12) ** 2
    size = np.bincount(region[inside], share, minlength=count)

    goes = (peak > SEED) & (at_border | (size > SMALLEST_HOLE))
    stays = inside[~goes[region[inside]]]
    beyond[stays] = _KEPT
    return beyond


def _smoothed(faces: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at vertices after a few averages with their neighbours: the rim is no rougher than
    the samples require."""
    pairs = side_pairs(faces)
    used, flat = np.unique(pairs, return_inverse=True)
    start, end = flat.reshape(-1, 2).T
    degree = np.bincount(start, minlength=len(used))
    local = values[used]
    for _ in range(SMOOTHINGS):
        around = np.bincount(start, local[end], minlength=len(used)) / degree
        local = 0.5 * (local + around)
    result = values.copy()
    result[used] = local
    return result


def cut(mesh: Mesh, level: NDArray[np.float64]) -> Mesh:
    """The part of a mesh where a function on its vertices is below 0, cut along its contour.

    Args:
        mesh: triangles.
        level: (v,) values, linear inside triangles.
    """
    vertices, level = _snapped(mesh, level)
    sign = np.sign(level[mesh.faces]).astype(np.int64)
    whole = (sign <= 0).all(axis=1) & (sign < 0).any(axis=1)
    split = (sign > 0).any(axis=1) & (sign < 0).any(axis=1)
    points, pieces = _pieces(vertices, level, mesh.faces[split])
    return Mesh(np.concatenate([vertices, points]), np.concatenate([mesh.faces[whole], pieces]))


def _snapped(
    mesh: Mesh, level: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vertices close to the contour moved onto it, so that no slivers are cut."""
    pairs = side_pairs(mesh.faces[(level[mesh.faces] > 0).any(axis=1)])
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
    vertices, level = mesh.vertices.copy(), level.copy()
    vertices[start] = mesh.vertices[start] * (1 - along) + mesh.vertices[end] * along
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
