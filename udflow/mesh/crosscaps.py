"""Cutting out cross-caps: slips after which a surface has one side only.

Where the field slips, at a crease or a thin place, flags can join what lies side by side by a
strip with half a turn. Whoever walks along it comes back turned over, after a few spacings; around
a Möbius strip that the samples show the way is long. The faces of such a way are cut out, and the
border that they leave, a single one, is closed like any other hole that is a failure of extraction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from udflow.compiled import over_rows
from udflow.mesh.crosscap_loops import MOST, turning_ways
from udflow.mesh.draft import Draft
from udflow.mesh.manifold import separated
from udflow.mesh.orientation import oriented
from udflow.mesh.topology import edges_of, side_ends

LONGEST = 7.0  # spacings around a cross-cap; samples do not show a Möbius strip so small
ROUNDS = 6


def without_crosscaps(draft: Draft, spacing: float) -> Draft:
    """The mesh with holes instead of cross-caps, oriented again.

    Args:
        draft: triangles, manifold but for true junctions.
        spacing: of the samples.
    """
    for _ in range(ROUNDS):
        beyond, turned = neighbours(draft.faces)
        if not turned.any():
            break
        draft = replace(draft, faces=oriented(draft.vertices, draft.faces, edges_of(draft.faces)))
        beyond, turned = neighbours(draft.faces)
        cut = _on_short_ways(draft, beyond, turned, LONGEST * spacing)
        if not cut.any():
            break
        loose = draft.loose.copy()
        loose[draft.faces[cut]] = True
        draft = separated(Draft(draft.vertices, draft.faces[~cut], loose).compacted(), spacing)
    return draft


def neighbours(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(f, 3) face behind each side, or -1, and whether it runs along it in the same direction."""
    sides = edges_of(faces).sides_where(2)
    beyond, turned = np.full(faces.size, -1), np.zeros(faces.size, dtype=bool)
    start, _ = side_ends(faces, sides)
    for one, two in ((0, 1), (1, 0)):
        beyond[sides[:, one]] = sides[:, two] // 3
        turned[sides[:, one]] = start[:, 0] == start[:, 1]
    return beyond.reshape(-1, 3), turned.reshape(-1, 3)


def _on_short_ways(
    draft: Draft, beyond: NDArray[np.int64], turned: NDArray[np.bool_], longest: float
) -> NDArray[np.bool_]:
    """(f,) faces on turning ways that do not touch each other, the shortest ones."""
    seeds = np.flatnonzero(turned.any(axis=1))
    centres = draft.vertices[draft.faces].mean(axis=1)
    way = np.zeros((len(seeds), MOST), dtype=np.int64)
    size, length = np.zeros(len(seeds), dtype=np.int64), np.full(len(seeds), np.inf)
    over_rows(
        turning_ways, len(seeds), seeds, longest, centres, beyond, turned, way, size, length,
        least=64,
    )  # fmt: skip
    cut = np.zeros(len(draft.faces), dtype=bool)
    taken = np.zeros(len(draft.vertices), dtype=bool)
    for i in np.argsort(length, kind="stable"):
        faces = way[i, : size[i]]
        if len(faces) > 0 and not taken[draft.faces[faces]].any():
            taken[draft.faces[faces]] = True
            cut[faces] = True
    return cut
