"""Vertices onto the surface of the field, where later steps have moved them off it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from udflow.fields.interface import EndingField, ProjectiveField
from udflow.mesh.draft import Draft
from udflow.mesh.filling import least_filling
from udflow.mesh.holes import border_loops, faces_between, joined
from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import edges_of, with_any

_TOLERANCE = 0.1  # voxels off the surface that nobody sees
_ASTRAY = 0.4  # voxels off the surface, after all, that show that there is none
_STEPS = 3
_LONGEST_GAP = 24  # edges around vertices left out together that other vertices can bridge
_FRONTS = 4  # rounds in which vertices that came to rest hold further ones
_SHARES = (0.5, 0.2, 0.05)  # of the way to a neighbour that are left to a vertex that never settles


def settled(mesh: Mesh, field: ProjectiveField, voxel: float, device: torch.device) -> Mesh:
    """The mesh with vertices that lie off the surface moved to their feet.

    Closing small holes and smoothing rims leave vertices beside the surface; a field that is asked
    at a vertex should answer that it is there. Where feet jump to and fro, as at the end of a
    crease, a vertex has no foot to rest on; it is drawn to a neighbour that has one.
    What never comes to rest is left out: single vertices for faces between their neighbours,
    many together, as between samples that are far apart, for a hole. At last vertices go to the
    ends of their trajectories where the field knows them more exactly.

    Args:
        mesh: in the unit frame.
        field: where the surface is.
        voxel: edge of a voxel, unit frame.
        device: of the field.
    """
    before = torch.from_numpy(mesh.vertices.astype(np.float32)).to(device)
    vertices = before.clone()
    astray = _settle(field, vertices, mesh.faces, voxel)
    if isinstance(field, EndingField):
        ends, sure = field.ends(vertices)
        vertices[sure] = ends[sure]
    result = mesh.vertices.copy()
    changed = (vertices != before).any(dim=1).cpu().numpy()
    result[changed] = vertices.cpu().numpy()[changed]
    return _without(replace(mesh, vertices=result), astray.cpu().numpy())


def _settle(
    field: ProjectiveField, vertices: Tensor, faces: NDArray[np.int64], voxel: float
) -> Tensor:
    """Moves vertices, in place, to where they rest; returns the indices of what rests nowhere."""
    moving = torch.arange(len(vertices), device=vertices.device)
    for _ in range(_STEPS):
        if len(moving) == 0:
            break
        feet = field.project(vertices[moving])
        off = (feet - vertices[moving]).norm(dim=1) > _TOLERANCE * voxel
        moving = moving[off]
        vertices[moving] = feet[off]
    moving = _unsettled(field, vertices, moving, voxel)
    for _ in range(_FRONTS):
        if len(moving) == 0:
            break
        _draw_to_neighbours(field, vertices, moving, faces, voxel)
        moving = _unsettled(field, vertices, moving, voxel)
    return _unsettled(field, vertices, moving, voxel, _ASTRAY)


def _without(mesh: Mesh, dropped: NDArray[np.int64]) -> Mesh:
    """The mesh without some vertices and the faces at them; small gaps that this leaves are closed
    by faces between the vertices that stay."""
    gone = np.zeros(len(mesh.vertices), dtype=bool)
    gone[dropped] = True
    faces = mesh.faces[~with_any(mesh.faces, gone)]
    if len(dropped) == 0 or len(faces) == 0:
        return mesh
    faces = np.concatenate([faces, *_bridges(mesh, faces)])
    used, numbers = np.unique(faces, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], numbers.reshape(-1, 3), colors)


def _bridges(mesh: Mesh, faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Faces over the short borders that the mesh has not, but some of its faces alone have."""
    edges = edges_of(mesh.faces)
    old = np.zeros(len(mesh.vertices), dtype=bool)
    old[edges.ends[edges.count != 2]] = True
    draft = Draft(mesh.vertices, faces, np.ones(len(old), dtype=bool))
    loops = [
        loop
        for loop in border_loops(draft)
        if len(loop) <= _LONGEST_GAP and not old[loop.vertices].any()
    ]
    between = faces_between(draft, loops)
    return [
        loop.vertices[least_filling(mesh.vertices[loop.vertices], joined(between, loop))[0]]
        for loop in loops
    ]


def _unsettled(
    field: ProjectiveField,
    vertices: Tensor,
    chosen: Tensor,
    voxel: float,
    tolerance: float = _TOLERANCE,
) -> Tensor:
    """Those of the chosen vertices that are farther from their feet than the tolerance."""
    if len(chosen) == 0:
        return chosen
    off = (field.project(vertices[chosen]) - vertices[chosen]).norm(dim=1)
    return chosen[off > tolerance * voxel]


def _draw_to_neighbours(
    field: ProjectiveField,
    vertices: Tensor,
    moving: Tensor,
    faces: NDArray[np.int64],
    voxel: float,
) -> None:
    """Moves unsettled vertices, in place, towards the nearest of their settled neighbours."""
    restless = torch.zeros(len(vertices), dtype=torch.bool, device=vertices.device)
    restless[moving] = True
    near = faces[with_any(faces, restless.cpu().numpy())]
    ends = torch.from_numpy(edges_of(near).ends).to(vertices.device)
    pairs = torch.cat([ends, ends.flip(1)])
    pairs = pairs[restless[pairs[:, 0]] & ~restless[pairs[:, 1]]]
    length = (vertices[pairs[:, 0]] - vertices[pairs[:, 1]]).norm(dim=1)
    pairs = pairs[torch.argsort(length, descending=True)]
    anchor = torch.full((len(vertices),), -1, device=vertices.device)
    anchor[pairs[:, 0]] = pairs[:, 1]  # the last one written is the nearest
    moving = moving[anchor[moving] >= 0]
    start = vertices.clone()
    for share in _SHARES:
        held = start[anchor[moving]]
        vertices[moving] = held + share * (start[moving] - held)
        moving = _unsettled(field, vertices, moving, voxel)
