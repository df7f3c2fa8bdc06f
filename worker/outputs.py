"""The files of a finished job."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from udflow.fields.storage import save_field
from udflow.mesh.export import MESH_FORMATS, write_mesh, write_points
from udflow.mesh.mesh import Mesh
from udflow.picture import mesh_picture
from udflow.png import png
from udflow.reconstruct import Reconstruction


@dataclass(frozen=True)
class Output:
    """name: of the file; write: fills it."""

    name: str
    write: Callable[[Path], object]


def outputs_of(result: Reconstruction) -> Iterator[Output]:
    """Every file that a job leaves: meshes for tools, the dense cloud, the field, the report,
    a picture."""
    yield from meshes_of(result.mesh)
    yield Output("points.ply", lambda path: write_points(result.points, path))
    yield Output("field.safetensors", lambda path: save_field(result.field, path))
    yield report_of(result.report)
    yield picture_of(result.mesh)


def meshes_of(mesh: Mesh) -> Iterator[Output]:
    """The mesh in every format."""
    for suffix in MESH_FORMATS:
        yield Output(f"mesh.{suffix}", lambda path: write_mesh(mesh, path))


def picture_of(mesh: Mesh) -> Output:
    """The mesh as a small picture."""
    return Output("preview.png", lambda path: path.write_bytes(png(mesh_picture(mesh))))


def report_of(values: dict[str, Any]) -> Output:
    """The report as JSON."""
    text = json.dumps(values, indent=2, allow_nan=False)
    return Output("report.json", lambda path: path.write_text(text))
