"""Cutting out handles too small to be part of the surface.

Where the field slips, at a crease or a thin place, flags can join what lies side by side by a
tunnel of a few triangles. Such a tunnel folds sharply. The patch around a fold is examined: if it
has one border but is no disc, it is cut out, and its border is closed like any other hole that is
a failure of extraction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.folds import at_folds
from udflow.mesh.topology import edges_of, parts, side_pairs, with_any

RINGS = 2  # of vertices around a fold that belong to its patch
LONGEST = 48  # edges of the border of a patch that may be cut out


def without_small_handles(draft: Draft) -> Draft:
    """The mesh with holes instead of small handles.

    Args:
        draft: oriented triangles.
    """
    edges = edges_of(draft.faces)
    folded = at_folds(draft.vertices, draft.faces, edges.sides_where(2))
    if not folded.any():
        return draft
    patch = np.flatnonzero(with_any(draft.faces, _grown(folded, edges.ends)))
    cut = patch[_in_wrong_patches(draft.faces[patch], len(draft.vertices))]
    if len(cut) == 0:
        return draft
    kept = np.ones(len(draft.faces), dtype=bool)
    kept[cut] = False
    loose = draft.loose.copy()
    loose[draft.faces[cut]] = True
    return Draft(draft.vertices, draft.faces[kept], loose).compacted()


def _grown(chosen: NDArray[np.bool_], ends: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(v,) the chosen vertices and those within RINGS edges of them."""
    for _ in range(RINGS - 1):
        touching = ends[with_any(ends, chosen)]
        chosen = chosen.copy()
        chosen[touching] = True
    return chosen


def _in_wrong_patches(faces: NDArray[np.int64], vertices: int) -> NDArray[np.bool_]:
    """(p,) faces in connected patches with a single, short border and a handle."""
    patch = parts(side_pairs(faces), vertices)
    count = int(patch.max()) + 1
    edges = edges_of(faces)
    of_edge = patch[edges.ends[:, 0]]
    used = np.unique(faces)
    euler = (
        np.bincount(patch[used], minlength=count)
        - np.bincount(of_edge, minlength=count)
        + np.bincount(patch[faces[:, 0]], minlength=count)
    )
    border = edges.ends[edges.count == 1]
    length = np.bincount(patch[border[:, 0]], minlength=count)
    loops = _loops(border, patch, count)
    manifold = np.bincount(of_edge, edges.count > 2, minlength=count) == 0
    wrong = (loops == 1) & (euler < 1) & (length <= LONGEST) & manifold
    result: NDArray[np.bool_] = wrong[patch[faces[:, 0]]]
    return result


def _loops(border: NDArray[np.int64], patch: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(count,) closed borders of each patch; several where a border touches itself."""
    used, ends = np.unique(border, return_inverse=True)
    ends = ends.reshape(-1, 2)
    loop = parts(ends, len(used))
    first = np.unique(loop, return_index=True)[1]
    loops = np.bincount(patch[used[first]], minlength=count)
    knots = used[np.bincount(ends.reshape(-1), minlength=len(used)) != 2]
    return loops + np.bincount(patch[knots], minlength=count)
