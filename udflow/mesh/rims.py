"""Fairing of rims: borders as smooth as the samples allow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.draft import Draft, Project
from udflow.mesh.topology import means_of_others, side_pairs, with_any

MOST_PASSES = 24
_RINGS = 2  # rings of vertices beside the rim that follow it
_SHRINK, _SWELL = 0.5, -0.526  # Taubin's pair: smooths a curve without shortening it


def faired(draft: Draft, width: float, voxel: float, project: Project) -> Draft:
    """The mesh with its borders smoothed along themselves and the nearest faces relaxed.

    A rim is cut where samples happen to lie, so it wavers by part of their spacing.

    Args:
        draft: triangles.
        width: wavelength up to which rims are smoothed, a few sample spacings.
        voxel: of the lattice, about the length of an edge.
        project: moves (n, 3) points back onto the surface.
    """
    edges = draft.loose_edges()
    rim = edges.ends[edges.count == 1]
    if len(rim) == 0:
        return draft
    passes = min(MOST_PASSES, math.ceil(0.25 * (width / voxel) ** 2))
    pairs, moving = _springs(draft, rim)
    vertices = draft.vertices.copy()
    for step in range(2 * passes):
        pull = means_of_others(vertices, pairs, moving) - vertices[moving]
        vertices[moving] += (_SWELL if step % 2 else _SHRINK) * pull
    vertices[moving] = project(vertices[moving])
    return replace(draft, vertices=vertices)


def _springs(draft: Draft, rim: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(p, 2) who is pulled by whom, and the vertices that move.

    Rim vertices are pulled by their neighbours on the rim alone, those beside it by all. Rim
    vertices where several borders meet stay.
    """
    level = np.full(len(draft.vertices), _RINGS + 1)
    level[rim] = 0
    for ring in range(_RINGS):
        near = draft.faces[with_any(draft.faces, level == ring)]
        level[near] = np.minimum(level[near], ring + 1)
    beside = side_pairs(draft.faces[with_any(draft.faces, level <= _RINGS)])
    beside = np.concatenate([beside, beside[:, ::-1]])
    beside = beside[(level[beside[:, 0]] > 0) & (level[beside[:, 0]] <= _RINGS)]
    along = np.concatenate([rim, rim[:, ::-1]])
    plain = np.bincount(along[:, 0], minlength=len(level)) == 2
    pairs = np.concatenate([along[plain[along[:, 0]]], beside])
    return pairs, np.unique(pairs[:, 0])
