"""Cutting false necks: tunnels through thin walls, tubes between sheets, tiny handles.

A slip of the field can join two sheets by a tube that is too thin to be seen in the samples.
Balls of a few spacings around the curved places of the surface are examined. Where a ball is no
disc, the shortest closed way that cannot be drawn together inside it goes around a tube or through
a handle. If both ends of the tube widen at once into sheets, it is cut along that way, and both
ends are closed; the limb of a body goes on as thin as it is, and stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.compiled import over_rows
from udflow.mesh.ball_loops import MOST
from udflow.mesh.draft import Draft, Project
from udflow.mesh.holes import border_loops, filled
from udflow.mesh.manifold import separated
from udflow.mesh.neck_loops import HANDLE, flare, search
from udflow.mesh.support import SampleSet, first_of_cluster
from udflow.mesh.topology import edges_of, face_normals, faces_around, side_ends, with_any

LONGEST = 3.5  # spacings around a neck that the samples cannot show
WIDENING = 3.0  # spacings from a neck within which both its ends widen into sheets
SHEET = 0.5  # part of the surface of a flat sheet around a neck that must be found there
BEND = 0.5  # part of the angle between the faces around the widest neck that makes a place curved
ROUNDS = 2
_AGAIN = 1.0  # longest ways from a cut within which is looked again
_STRIDE = 0.5  # of half of the longest way: about that near to it lies an examined vertex


@dataclass(frozen=True)
class _Surface:
    """Triangles with a cone over every border.

    Attributes:
        vertices, faces, first, around, beyond: see `neck_loops.search`.
        curved: (v,) bool, vertices at which a neck may be.
        real: vertices from this one on are tips of cones.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    first: NDArray[np.int64]
    around: NDArray[np.int64]
    beyond: NDArray[np.int64]
    curved: NDArray[np.bool_]
    real: int

    def mesh(self) -> tuple[NDArray[Any], ...]:
        """What compiled loops take."""
        return self.vertices, self.faces, self.first, self.around, self.beyond


def without_necks(draft: Draft, samples: SampleSet, project: Project) -> Draft:
    """The mesh with false necks cut, and their ends closed.

    Args:
        draft: oriented triangles; borders that it has stay.
        samples: the data.
        project: moves (n, 3) new vertices onto the surface.
    """
    near: NDArray[np.float64] | None = None
    for _ in range(ROUNDS):
        ways = _false_ways(draft, samples, near)
        if not ways:
            break
        near = draft.vertices[np.concatenate(ways)]
        draft = _cut(draft, ways, samples.spacing, project)
    return draft


def _false_ways(
    draft: Draft, samples: SampleSet, near: NDArray[np.float64] | None
) -> list[NDArray[np.int64]]:
    """Closed ways around false necks that do not touch each other, the shortest first.

    near: (n, 3) places around which alone anything has changed since the last look.
    """
    surface = _capped(draft, samples.spacing)
    seeds, spacing = _seeds(surface, samples, near)
    kind, ways, length = _short_ways(surface, seeds, spacing)
    order = np.argsort(length, kind="stable")
    short = [i for i in order[length[order] <= LONGEST * spacing[order]]
             if ways[i].max() < surface.real]  # fmt: skip
    chosen = [ways[i] for i in short]
    if not chosen:
        return []
    wide, meet = _widening(surface, chosen, length[short], spacing[short])
    false = wide | (meet & (kind[short] == HANDLE))
    return _apart(draft, [way for way, wrong in zip(chosen, false, strict=True) if wrong])


def _short_ways(
    surface: _Surface, seeds: NDArray[np.int64], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.int64], list[NDArray[np.int64]], NDArray[np.float64]]:
    """What the balls around n seeds hold, their shortest ways and the lengths of these, infinite
    for a disc."""
    kind = np.zeros(len(seeds), dtype=np.int64)
    size = np.zeros(len(seeds), dtype=np.int64)
    way = np.zeros((len(seeds), MOST), dtype=np.int64)
    reach = 0.5 * LONGEST * (1 + _STRIDE) * spacing
    over_rows(search, len(seeds), seeds, reach, *surface.mesh(), kind, way, size)
    ways = [row[:count] for row, count in zip(way, size, strict=True)]
    return kind, ways, _lengths(surface.vertices, way, size)


def _widening(
    surface: _Surface,
    ways: list[NDArray[np.int64]],
    length: NDArray[np.float64],
    spacing: NDArray[np.float64],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) whether the surface widens into sheets on both sides of ways, and whether the two
    sides are joined nearby."""
    size = np.array([len(way) for way in ways])
    rows = np.zeros((len(ways), MOST), dtype=np.int64)
    for row, way in zip(rows, ways, strict=True):
        row[: len(way)] = way
    area, meet = np.zeros((len(ways), 2)), np.zeros(len(ways), dtype=bool)
    reach = WIDENING * spacing
    over_rows(flare, len(ways), rows, size, reach, *surface.mesh(), surface.real, area, meet)
    sheet = reach * length + SHEET * np.pi * reach**2
    return np.where(meet, area.sum(axis=1), area.min(axis=1)) >= sheet, meet


def _lengths(
    vertices: NDArray[np.float64], way: NDArray[np.int64], size: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n,) lengths of closed ways, (n, m) of which `size` vertices each count; none is infinite."""
    result = np.full(len(size), np.inf)
    some = np.flatnonzero(size)
    way, size = way[some], size[some, None]
    place = np.arange(way.shape[1])
    following = np.take_along_axis(way, np.where(place + 1 < size, place + 1, 0), axis=1)
    edge = np.linalg.norm(vertices[way] - vertices[following], axis=2)
    result[some] = np.where(place < size, edge, 0.0).sum(axis=1)
    return result


def _capped(draft: Draft, spacing: float) -> _Surface:
    """The surface with a cone over every border, so that a hole is no neck."""
    vertices, faces = draft.vertices, draft.faces
    cones, centres = [faces], [vertices]
    for i, loop in enumerate(border_loops(draft)):
        ring = loop.vertices
        hub = np.full(len(ring), len(vertices) + i)
        cones.append(np.stack([ring, np.roll(ring, -1), hub], axis=1))
        centres.append(vertices[ring].mean(axis=0)[None])
    real, faces, vertices = len(vertices), np.concatenate(cones), np.concatenate(centres)
    first, around = faces_around(faces, len(vertices))
    edges = edges_of(faces)
    sides = edges.sides_where(2)
    beyond = np.full(faces.size, -1)
    beyond[sides[:, 0]], beyond[sides[:, 1]] = sides[:, 1] // 3, sides[:, 0] // 3
    normals = face_normals(vertices, faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    apart = draft.vertices[draft.faces[:, 0]] - draft.vertices[draft.faces[:, 1]]
    turn = 2 * np.pi * np.linalg.norm(apart, axis=1).mean() / (LONGEST * spacing)
    curved_below = np.cos(min(BEND * turn, 0.5 * np.pi))
    cosine = np.einsum("ij,ij->i", normals[sides[:, 0] // 3], normals[sides[:, 1] // 3])
    bend = cosine < curved_below
    curved = np.zeros(len(vertices), dtype=bool)
    for end in side_ends(faces, sides[bend, 0]):
        curved[end] = True
    curved[real:] = False
    return _Surface(vertices, faces, first, around, beyond.reshape(-1, 3), curved, real)


def _seeds(
    surface: _Surface, samples: SampleSet, near: NDArray[np.float64] | None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Vertices whose balls cover all curved places, or those near some places, and the spacing of
    the samples there."""
    curved = np.flatnonzero(surface.curved)
    if near is not None:
        away = cKDTree(near).query(surface.vertices[curved], workers=2)[0]
        curved = curved[away < _AGAIN * LONGEST * samples.spacing]
    if len(curved) == 0:
        return curved, np.zeros(0)
    width = _STRIDE * 0.5 * LONGEST * samples.spacing
    seeds = curved[np.sort(first_of_cluster(surface.vertices[curved], width)[0])]
    count = min(9, len(samples.points))
    radius = samples.tree.query(surface.vertices[seeds], k=[count], workers=2)[0][:, 0]
    return seeds, radius * np.sqrt(np.pi / count)


def _apart(draft: Draft, ways: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Those of the ways whose faces no earlier one touches, nor a border."""
    taken = np.zeros(len(draft.vertices), dtype=bool)
    edges = draft.loose_edges()
    taken[edges.ends[edges.count != 2]] = True
    result = []
    first, around = faces_around(draft.faces, len(draft.vertices))
    for way in ways:
        faces = np.concatenate([around[first[v] : first[v + 1]] for v in way])
        near = draft.faces[faces].reshape(-1)
        if not taken[near].any():
            taken[near] = True
            result.append(way)
    return result


def _cut(draft: Draft, ways: list[NDArray[np.int64]], spacing: float, project: Project) -> Draft:
    """The mesh without the faces at the ways, and the holes that this leaves filled."""
    gone = np.zeros(len(draft.vertices), dtype=bool)
    gone[np.concatenate(ways)] = True
    cut = with_any(draft.faces, gone)
    loose = draft.loose.copy()
    loose[draft.faces[cut]] = True
    old = np.zeros(len(draft.vertices), dtype=bool)
    edges = draft.loose_edges()
    old[edges.ends[edges.count != 2]] = True
    kept = draft.faces[~cut]
    used = np.unique(kept)
    draft = separated(Draft(draft.vertices, kept, loose).compacted(), spacing)
    old = np.concatenate([old[used], np.zeros(len(draft.vertices) - len(used), dtype=bool)])
    loops = [loop for loop in border_loops(draft) if not old[loop.vertices].any()]
    return filled(draft, loops, project)
