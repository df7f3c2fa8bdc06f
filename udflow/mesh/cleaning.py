"""Removing what is no surface: false sheets and dust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import compacted, face_normals, parts

LONGEST_WAY = 0.75  # voxels from the mean crossing to its foot: farther, it was no crossing
SMALL = 40.0  # squared spacings of area below which a part must prove that samples support it
FEWEST_SAMPLES = 8  # that a small part must have nearer to it than to any other part


def without_false_sheets(mesh: Mesh, moved: NDArray[np.float64], voxel: float) -> Mesh:
    """The mesh without faces at vertices that were not on the surface.

    Args:
        mesh: triangles over vertices on the surface.
        moved: (v,) how far each vertex lay from the surface before it was projected.
        voxel: of the lattice.
    """
    astray = moved > LONGEST_WAY * voxel
    return compacted(Mesh(mesh.vertices, mesh.faces[~astray[mesh.faces].any(axis=1)]))


def without_dust(mesh: Mesh, samples: NDArray[np.float64], spacing: float) -> Mesh:
    """The mesh without small parts that hardly any sample supports.

    Args:
        mesh: triangles.
        samples: (m, 3) the data.
        spacing: typical distance of neighbouring samples.
    """
    part = parts(mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2), len(mesh.vertices))
    area = np.bincount(part[mesh.faces[:, 0]], 0.5 * np.linalg.norm(face_normals(mesh), axis=1))
    small = area < SMALL * spacing**2
    if not small[part].any() or small[part].all():
        return mesh
    candidates = cKDTree(mesh.vertices[small[part]])
    distance = candidates.query(samples, workers=2, distance_upper_bound=2 * spacing)[0]
    near = samples[np.isfinite(distance)]
    nearest = cKDTree(mesh.vertices, balanced_tree=False).query(near, workers=2)[1]
    support = np.bincount(part[nearest], minlength=len(area))
    kept = ~small | (support >= FEWEST_SAMPLES)
    return compacted(Mesh(mesh.vertices, mesh.faces[kept[part[mesh.faces[:, 0]]]]))
