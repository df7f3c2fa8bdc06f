"""Removing dust: parts that the samples do not speak for."""

from __future__ import annotations

import numpy as np
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
    distance = candidates.query(samples.points, workers=2, distance_upper_bound=2 * spacing)[0]
    near = samples.points[np.isfinite(distance)]
    nearest = cKDTree(vertices, balanced_tree=False).query(near, workers=2)[1]
    support = np.bincount(part[nearest], minlength=len(area))
    kept = ~doubtful | (support >= FEWEST_SAMPLES)
    return Draft(vertices, faces[kept[part[faces[:, 0]]]], draft.loose).compacted()
