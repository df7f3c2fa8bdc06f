"""The files of a finished job."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from udflow.fields.storage import save_field
from udflow.mesh.export import MESH_FORMATS, write_mesh, write_points
from udflow.reconstruct import Reconstruction


@dataclass(frozen=True)
class Output:
    """name: of the file; write: fills it."""

    name: str
    write: Callable[[Path], object]


def outputs_of(result: Reconstruction) -> Iterator[Output]:
    """Every file that a job leaves: meshes for tools, the dense cloud, the field, the report."""
    for suffix in MESH_FORMATS:
        yield Output(f"mesh.{suffix}", lambda path: write_mesh(result.mesh, path))
    yield Output("points.ply", lambda path: write_points(result.points, path))
    yield Output("field.safetensors", lambda path: save_field(result.field, path))
    report = json.dumps(result.report, indent=2, allow_nan=False)
    yield Output("report.json", lambda path: path.write_text(report))
