"""Smoothing folds: where neighbouring faces lie nearly back to back.

At creases between few samples feet may lie beyond the end of a face, and the mesh there has flaps
and spikes that fold sharply. Edges of solid things fold as well, but seldom more sharply than a
right angle; what does is drawn to its neighbours, away from the field, which is wrong there. A thin
blade loses part of a voxel by it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import edges_of, face_normals, means_of_others, side_ends, with_any

FOLD = -0.2  # cosine between the normals of neighbouring faces below which they are folded
_ROUNDS = 2


def unfolded(mesh: Mesh) -> Mesh:
    """The mesh with the vertices at folds moved to the means of their neighbours; borders stay."""
    edges = edges_of(mesh.faces)
    folded = at_folds(mesh.vertices, mesh.faces, edges.sides_where(2))
    if not folded.any():
        return mesh
    near = folded.copy()
    near[edges.ends[with_any(edges.ends, folded)]] = True
    faces = mesh.faces[with_any(mesh.faces, near)]
    near[edges.ends[edges.count != 2]] = False
    around = edges_of(faces)
    sides, pairs = around.sides_where(2), np.concatenate([around.ends, around.ends[:, ::-1]])
    vertices = mesh.vertices.copy()
    for _ in range(_ROUNDS):
        folded = near & at_folds(vertices, faces, sides)
        pulled = pairs[folded[pairs[:, 0]]]
        moving = np.flatnonzero(folded)
        vertices[moving] = means_of_others(vertices, pulled, moving)
    return replace(mesh, vertices=vertices)


def at_folds(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], sides: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """(v,) ends of edges at which two faces are folded onto each other.

    Args:
        vertices: (v, 3).
        faces: (f, 3).
        sides: (e, 2) those of the edges to look at, see `Edges`.
    """
    normals = face_normals(vertices, faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    one, two = normals[sides // 3].transpose(1, 0, 2)
    start = faces.reshape(-1)[sides]
    turned = np.where(start[:, 0] == start[:, 1], -1.0, 1.0)  # where a strip of one side closes
    fold = sides[turned * np.einsum("ei,ei->e", one, two) < FOLD, 0]
    result = np.zeros(len(vertices), dtype=bool)
    for end in side_ends(faces, fold):
        result[end] = True
    return result
