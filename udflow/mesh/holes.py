"""Closing holes that are failures of extraction, not ends of the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.draft import Draft, Project
from udflow.mesh.filling import LONGEST, least_filling
from udflow.mesh.support import SampleSet
from udflow.mesh.topology import face_normals, parts, side_ends
from udflow.mesh.trim import SMALLEST_HOLE, SURE_GAP

LARGEST = 60.0  # squared spacings that may be closed
COVERED = 0.2  # part of the samples due on a patch that show it to be surface,
CHANCE = 2  # and samples of the rim that may seem to lie on it
FLAT = 0.0  # cosine between neighbouring faces of a patch below which another one is tried
_FAN = 10  # vertices around one centre at most; longer loops get rings first


@dataclass(frozen=True)
class Loop:
    """A closed border.

    Attributes:
        vertices: (n,) in the order of the missing faces.
        outside: (n,) face at the side from each vertex to the next.
    """

    vertices: NDArray[np.int64]
    outside: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.vertices)


@dataclass(frozen=True)
class _Patch:
    """What fills a loop: (k, 3) new vertices, and faces whose corners count the loop's vertices
    first and the new ones after them."""

    points: NDArray[np.float64]
    faces: NDArray[np.int64]


def closed(draft: Draft, samples: SampleSet, project: Project) -> Draft:
    """The mesh with holes closed that are too small to show in samples, and larger ones where
    the data goes on: around the hole, or on the patch that would close it.

    Args:
        draft: oriented triangles.
        samples: the data.
        project: moves (n, 3) new vertices onto the surface.
    """
    loops = [loop for loop in border_loops(draft) if len(loop) <= LONGEST]
    if not loops:
        return draft
    patches = _patches(draft, loops, project)
    false = _failures(draft, loops, patches, samples)
    pairs = zip(loops, patches, strict=True)
    return _with_patches(draft, [pair for pair, wrong in zip(pairs, false, strict=True) if wrong])


def filled(draft: Draft, loops: list[Loop], project: Project) -> Draft:
    """The mesh with these loops filled."""
    if not loops:
        return draft
    return _with_patches(draft, list(zip(loops, _patches(draft, loops, project), strict=True)))


def _with_patches(draft: Draft, pairs: list[tuple[Loop, _Patch]]) -> Draft:
    faces, points, count = [draft.faces], [np.zeros((0, 3))], len(draft.vertices)
    for loop, patch in pairs:
        number = np.concatenate([loop.vertices, count + np.arange(len(patch.points))])
        faces.append(number[patch.faces])
        points.append(patch.points)
        count += len(patch.points)
    return draft.replaced(np.concatenate(points), np.concatenate(faces)) if pairs else draft


def border_loops(draft: Draft) -> list[Loop]:
    """Closed borders that pass every vertex once."""
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
    outside = np.zeros(len(used), dtype=np.int64)
    outside[start] = sides // 3
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order], prepend=-1))
    loops = []
    for first, count in zip(order[bounds], np.diff(bounds, append=len(order)), strict=True):
        if not broken[label[first]]:
            walk = _walk(following, int(first), int(count))
            loops.append(Loop(used[walk], outside[walk]))
    return loops


def _walk(following: NDArray[np.int64], first: int, count: int) -> NDArray[np.int64]:
    loop = np.empty(count, dtype=np.int64)
    for i in range(count):
        loop[i] = first
        first = int(following[first])
    return loop


def _failures(
    draft: Draft, loops: list[Loop], patches: list[_Patch], samples: SampleSet
) -> list[bool]:
    """Which of the loops are failures of extraction."""
    spacing = np.array([_spacing(draft, loop, samples) for loop in loops])
    area = np.array([_area(draft, *pair) for pair in zip(loops, patches, strict=True)])
    due = area / spacing**2
    wide = _gaps(draft, loops, patches, samples) > SURE_GAP * spacing
    covered = _samples_on(draft, loops, patches, samples) > CHANCE + COVERED * due
    false = (due <= SMALLEST_HOLE) | ((due <= LARGEST) & (~wide | covered))
    return [bool(wrong) for wrong in false]


def _spacing(draft: Draft, loop: Loop, samples: SampleSet) -> float:
    """Of the samples along a loop."""
    nearest = samples.tree.query(draft.vertices[loop.vertices])[1]
    return float(np.median(samples.around[nearest]))


def _gaps(
    draft: Draft, loops: list[Loop], patches: list[_Patch], samples: SampleSet
) -> NDArray[np.float64]:
    """(n,) how far the centres of the faces of each patch are from all samples, at most."""
    places = [
        np.concatenate([draft.vertices[loop.vertices], patch.points])[patch.faces].mean(axis=1)
        for loop, patch in zip(loops, patches, strict=True)
    ]
    of = np.repeat(np.arange(len(patches)), [len(some) for some in places])
    result = np.zeros(len(patches))
    np.maximum.at(result, of, samples.tree.query(np.concatenate(places), workers=2)[0])
    return result


def _area(draft: Draft, loop: Loop, patch: _Patch) -> float:
    """Of the least surface over a loop, but no more than its patch has."""
    least = least_filling(draft.vertices[loop.vertices])[1]
    corners = np.concatenate([draft.vertices[loop.vertices], patch.points])
    return min(least, 0.5 * float(np.linalg.norm(face_normals(corners, patch.faces), axis=1).sum()))


def _samples_on(
    draft: Draft, loops: list[Loop], patches: list[_Patch], samples: SampleSet
) -> NDArray[np.intp]:
    """(n,) samples beside the new vertices of each patch, nearer to them than to the border."""
    rim = np.concatenate([loop.vertices for loop in loops])
    points = np.concatenate([patch.points for patch in patches])
    of = np.repeat(np.arange(len(patches)), [len(patch.points) for patch in patches])
    tree = cKDTree(np.concatenate([points, draft.vertices[rim]]))
    nearest = tree.query(samples.points, workers=2, distance_upper_bound=samples.spacing)[1]
    return np.bincount(of[nearest[nearest < len(points)]], minlength=len(patches))


def _patches(draft: Draft, loops: list[Loop], project: Project) -> list[_Patch]:
    """What fills the loops, with new vertices on the surface; where that leaves folds, without
    new vertices if it is flatter."""
    patches = [_rings(draft.vertices[loop.vertices]) for loop in loops]
    added = np.concatenate([patch.points for patch in patches])
    added = project(added) if len(added) > 0 else added
    feet = np.split(added, np.cumsum([len(patch.points) for patch in patches])[:-1])
    faces = faces_between(draft, loops)
    result = []
    for loop, patch, points in zip(loops, patches, feet, strict=True):
        chosen = _Patch(points, patch.faces)
        flatness = _flatness(draft, loop, chosen)
        if flatness < FLAT:
            corners = draft.vertices[loop.vertices]
            plain = _Patch(np.zeros((0, 3)), least_filling(corners, joined(faces, loop))[0])
            if len(plain.faces) > 0 and _flatness(draft, loop, plain) > flatness:
                chosen = plain
        result.append(chosen)
    return result


def _flatness(draft: Draft, loop: Loop, patch: _Patch) -> float:
    """The least cosine between neighbouring faces of a patch, and between it and its outside."""
    corners = np.concatenate([draft.vertices[loop.vertices], patch.points])
    normals = _unit(face_normals(corners, patch.faces))
    outside = _unit(face_normals(draft.vertices, draft.faces[loop.outside]))
    count = len(corners)
    start, end = patch.faces.reshape(-1), np.roll(patch.faces, -1, axis=1).reshape(-1)
    owner = np.repeat(np.arange(len(patch.faces)), 3)
    rim = np.arange(len(loop))
    key = np.concatenate([start * count + end, ((rim + 1) % len(loop)) * count + rim])
    across = np.concatenate([end * count + start, rim * count + (rim + 1) % len(loop)])
    every = np.concatenate([normals[owner], outside])
    order = np.argsort(key)
    partner = order[np.searchsorted(key[order], across).clip(max=len(key) - 1)]
    matched = key[partner] == across
    return float(np.einsum("ij,ij->i", every, every[partner])[matched].min())


def faces_between(draft: Draft, loops: list[Loop]) -> NDArray[np.int64]:
    """(n, 3) faces with two corners or more on any of the loops."""
    on_rim = np.zeros(len(draft.vertices), dtype=bool)
    for loop in loops:
        on_rim[loop.vertices] = True
    between: NDArray[np.int64] = draft.faces[on_rim[draft.faces].sum(axis=1) >= 2]
    return between


def joined(faces: NDArray[np.int64], loop: Loop) -> NDArray[np.bool_]:
    """(n, n) which vertices of a loop (n, 3) faces join by an edge already."""
    order = np.argsort(loop.vertices)
    found = np.searchsorted(loop.vertices, faces, sorter=order).clip(max=len(loop) - 1)
    place = np.where(loop.vertices[order[found]] == faces, order[found], -1)
    place = place[(place >= 0).sum(axis=1) >= 2]
    result = np.zeros((len(loop) + 1, len(loop) + 1), dtype=bool)
    for one, two in ((0, 1), (1, 2), (2, 0)):
        result[place[:, one], place[:, two]] = True
        result[place[:, two], place[:, one]] = True
    return result[:-1, :-1]


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    unit: NDArray[np.float64] = vectors / np.maximum(
        np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30
    )
    return unit


def _rings(corners: NDArray[np.float64]) -> _Patch:
    """Rings of half as many vertices while a loop is long, then a fan."""
    loop = np.arange(len(corners))
    if len(loop) == 3:
        return _Patch(np.zeros((0, 3)), loop[None])
    centre, count = corners.mean(axis=0), len(corners)
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
    return _Patch(np.concatenate(points), np.concatenate(faces))


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
