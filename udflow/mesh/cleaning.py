"""Removing dust: parts that the samples do not speak for."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from udflow.mesh.draft import Draft
from udflow.mesh.support import SampleSet
from udflow.mesh.topology import face_normals, parts

SMALL = 40.0  # squared spacings of area below which a part must prove that samples support it
FEWEST_SAMPLES = 8  # that a small part must have nearer to it than to any other part


def without_dust(draft: Draft, samples: SampleSet, voxel: float) -> Draft:
    """The mesh without small parts that hardly any sample supports.

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
    area = 0.5 * np.bincount(part[faces[:, 0]], doubled, minlength=int(part.max()) + 1)
    small = area < SMALL * spacing**2
    if not small.any() or small.all():
        return draft
    candidates = cKDTree(vertices[small[part]])
    distance = candidates.query(samples.points, workers=2, distance_upper_bound=2 * spacing)[0]
    near = samples.points[np.isfinite(distance)]
    nearest = cKDTree(vertices, balanced_tree=False).query(near, workers=2)[1]
    support = np.bincount(part[nearest], minlength=len(area))
    kept = ~small | (support >= FEWEST_SAMPLES)
    return Draft(vertices, faces[kept[part[faces[:, 0]]]], draft.loose).compacted()
