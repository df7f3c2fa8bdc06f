"""Vertices onto the surface of the field, where later steps have moved them off it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from udflow.fields.interface import ProjectiveField
from udflow.mesh.mesh import Mesh

_TOLERANCE = 0.1  # voxels off the surface that nobody sees
_STEPS = 3


def settled(mesh: Mesh, field: ProjectiveField, voxel: float, device: torch.device) -> Mesh:
    """The mesh with vertices that lie off the surface moved to their feet.

    Closing small holes and smoothing rims leave vertices beside the surface; a field that is asked
    at a vertex should answer that it is there.

    Args:
        mesh: in the unit frame.
        field: where the surface is.
        voxel: edge of a voxel, unit frame.
        device: of the field.
    """
    vertices = torch.from_numpy(mesh.vertices.astype(np.float32)).to(device)
    moving = torch.arange(len(vertices), device=device)
    for _ in range(_STEPS):
        feet = field.project(vertices[moving])
        off = (feet - vertices[moving]).norm(dim=1) > _TOLERANCE * voxel
        moving = moving[off]
        if len(moving) == 0:
            break
        vertices[moving] = feet[off]
    result = mesh.vertices.copy()
    changed = (vertices.cpu().numpy() != mesh.vertices.astype(np.float32)).any(axis=1)
    result[changed] = vertices.cpu().numpy()[changed]
    return replace(mesh, vertices=result)
