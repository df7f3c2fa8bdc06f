"""Meshes and points to files. Atomic writing is up to the caller."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import BinaryIO, Literal, get_args

import numpy as np

from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.shift import suggested_shift
from udflow.errors import EmptySurface
from udflow.mesh.formats.glb import UpAxis, write_glb
from udflow.mesh.formats.obj import write_obj
from udflow.mesh.formats.ply import write_ply
from udflow.mesh.formats.stl import write_stl
from udflow.mesh.mesh import Mesh

MeshFormat = Literal["ply", "glb", "obj", "stl"]
MESH_FORMATS: tuple[MeshFormat, ...] = get_args(MeshFormat)
Vector = tuple[float, float, float]

_NO_SHIFT: Vector = (0.0, 0.0, 0.0)
_SINGLE_PRECISION = ("glb", "stl")


def write_mesh(
    mesh: Mesh,
    target: Path | BinaryIO,
    format: MeshFormat | None = None,
    *,
    up: UpAxis = "z",
    shift: Vector | None = None,
) -> Vector:
    """Write a mesh of the world frame.

    PLY (double) and OBJ (16 digits) keep the coordinates of the source. GLB and STL hold single
    precision only, which would tear map coordinates apart: where those are large they are written
    relative to a shift, stated in the file (GLB: `extras.udflow.shift` of asset and node; STL:
    the 80-byte header).

    Args:
        target: a path or a binary stream.
        format: None takes the suffix of the path.
        up: the source's upward axis; GLB, which is Y-up, turns "z" by a rotation of its node. The
            other formats keep the axes of the source.
        shift: subtract this and say so in the file, whatever the format; None chooses as above.

    Returns:
        The shift that was subtracted: file coordinates + shift = world coordinates.

    Raises:
        EmptySurface: the mesh has no triangles.
        ValueError: the format is unknown or cannot hold so large a mesh.
    """
    chosen = _format(target, format)
    if len(mesh.faces) == 0:
        raise EmptySurface("the mesh has no triangles, so there is nothing to write")
    used = _shift(mesh, chosen) if shift is None else shift
    local = mesh
    comments: tuple[str, ...] = ()
    if used != _NO_SHIFT:
        local = Mesh(mesh.vertices - np.asarray(used), mesh.faces, mesh.colors)
        comments = (f"shift {used[0]!r} {used[1]!r} {used[2]!r}",)
    with _opened(target) as file:
        if chosen == "ply":
            write_ply(
                file, local.vertices, faces=local.faces, colors=local.colors, comments=comments
            )
        elif chosen == "obj":
            write_obj(file, local, comments=comments)
        elif chosen == "stl":
            write_stl(file, local, comments=comments)
        else:
            write_glb(file, local, up=up, shift=used)
    return used


def write_points(cloud: PointCloud, target: Path | BinaryIO) -> None:
    """Write points with their colours and normals as PLY in double precision."""
    with _opened(target) as file:
        write_ply(file, cloud.points, colors=cloud.colors, normals=cloud.normals)


def _format(target: Path | BinaryIO, format: MeshFormat | None) -> MeshFormat:
    name: str | None = format
    if name is None and isinstance(target, Path):
        name = target.suffix.lstrip(".").lower()
    for known in MESH_FORMATS:
        if name == known:
            return known
    raise ValueError(f"unknown mesh format {name!r}; choose one of: {', '.join(MESH_FORMATS)}")


def _shift(mesh: Mesh, format: MeshFormat) -> Vector:
    if format not in _SINGLE_PRECISION:
        return _NO_SHIFT
    return suggested_shift(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) or _NO_SHIFT


def _opened(target: Path | BinaryIO) -> AbstractContextManager[BinaryIO]:
    return target.open("wb") if isinstance(target, Path) else nullcontext(target)
