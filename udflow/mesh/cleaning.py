"""Removing dust: parts that the samples do not speak for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.draft import Draft
from udflow.mesh.support import SampleSet
from udflow.mesh.topology import face_normals, parts

FEWEST_SAMPLES = 20  # that a part must have nearer to it than to any other part


def without_dust(draft: Draft, samples: SampleSet, voxel: float) -> Draft:
    """The mesh without parts that hardly any sample supports, be they small or sheets between
    samples far apart; the largest stays.

    Args:
        draft: triangles.
        samples: the data.
        voxel: of the lattice.
    """
    spacing = max(samples.spacing, voxel)
    vertices, faces = draft.vertices, draft.faces
    part = parts(faces[:, [0, 1, 1, 2]].reshape(-1, 2), len(vertices))
    if part.max(initial=0) == 0:
        return draft
    doubled = np.linalg.norm(face_normals(vertices, faces), axis=1)
    area = np.bincount(part[faces[:, 0]], doubled)
    doubtful = np.ones(len(area), dtype=bool)
    doubtful[area.argmax()] = False
    candidates = cKDTree(vertices[doubtful[part]])

    def beside(points: NDArray[np.float64], spacings: float) -> NDArray[np.bool_]:
        reach = spacings * spacing
        return np.isfinite(candidates.query(points, workers=2, distance_upper_bound=reach)[0])

    near = samples.points[beside(samples.points, 2.0)]
    # what is nearest to these lies within 2 spacings of them, and 4 of a doubtful part
    around = np.flatnonzero(beside(vertices, 4.0))
    nearest = around[cKDTree(vertices[around], balanced_tree=False).query(near, workers=2)[1]]
    support = np.bincount(part[nearest], minlength=len(area))
    kept = ~doubtful | (support >= FEWEST_SAMPLES)
    return Draft(vertices, faces[kept[part[faces[:, 0]]]], draft.loose).compacted()
