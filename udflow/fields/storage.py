"""Fitted fields as safetensors: no pickle, every value checked on the way in."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.quadrics import LocalQuadrics, QuadricSurface
from udflow.errors import BadField
from udflow.fields.lattice import SparseLattice
from udflow.fields.spline import SplineField, SplineGrid, SplineLevel
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.flow.schedule import TimeSchedule

FORMAT = "udflow-spline-field"
VERSION = 1
_QUADRICS = {  # name -> trailing shape
    "origin": (3,),
    "frame": (3, 3),
    "coefficients": (6,),
    "radius": (),
    "error": (),
    "spacing": (),
}
_MAX_LATTICE = 640  # points along an axis; 512 cells and their margin need fewer


def field_to_bytes(field: UnsignedDistanceField) -> bytes:
    """The field as the bytes of a safetensors file."""
    tensors: dict[str, Tensor] = {}
    levels: list[dict[str, Any]] = []
    for i, level in enumerate(field.spline.levels):
        grid = level.grid
        tensors[f"level{i}.coefficients"] = level.coefficients.cpu().contiguous()
        tensors[f"level{i}.cells"] = grid.cells.coordinates.to(torch.int16).cpu().contiguous()
        levels.append(
            {"origin": grid.origin.tolist(), "spacing": grid.spacing, "shape": grid.cells.shape}
        )
    for name in _QUADRICS:
        tensors[f"quadrics.{name}"] = getattr(field.surface.quadrics, name).cpu().contiguous()
    tensors["quadrics.count"] = field.surface.quadrics.count.cpu().contiguous()
    header = {
        "format": FORMAT,
        "version": VERSION,
        "steps": field.spline.schedule.steps,
        "centre": field.normalisation.centre,
        "scale": field.normalisation.scale,
        "levels": levels,
    }
    return to_bytes(tensors, metadata={"udflow": json.dumps(header)})


def save_field(field: UnsignedDistanceField, path: Path) -> None:
    """Writes the field to `path`."""
    path.write_bytes(field_to_bytes(field))


def load_field(path: Path, device: str = "cpu") -> UnsignedDistanceField:
    """Reads a field written by `save_field`.

    Raises:
        BadField: not such a file, damaged, or of a version this release does not know.
        FileNotFoundError: no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no field at {path}")
    try:
        with safe_open(str(path), framework="pt", device=device) as file:
            header = json.loads((file.metadata() or {}).get("udflow", "{}"))
            _check_header(header)
            levels = tuple(
                _level(
                    described,
                    file.get_tensor(f"level{i}.coefficients"),
                    file.get_tensor(f"level{i}.cells"),
                )
                for i, described in enumerate(header["levels"])
            )
            surface = _surface(
                {name: file.get_tensor(f"quadrics.{name}") for name in (*_QUADRICS, "count")}
            )
        x, y, z = (float(c) for c in header["centre"])
        normalisation = Normalisation((x, y, z), float(header["scale"]))
        schedule = TimeSchedule(int(header["steps"]))
    except BadField:
        raise
    except (
        SafetensorError,
        LookupError,
        TypeError,
        ValueError,
        ArithmeticError,
        RuntimeError,
    ) as error:
        raise BadField(f"{path.name} is not a readable udflow field: {error}") from error
    return UnsignedDistanceField(SplineField(schedule, levels), surface, normalisation)


def _check_header(header: Any) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise BadField("the file holds no udflow field; fit one with udflow reconstruct --field")
    if header.get("version") != VERSION:
        raise BadField(
            f"the field has version {header.get('version')}, this release reads {VERSION}; "
            "fit it again"
        )
    if not 0 < len(header["levels"]) == header["steps"]:
        raise BadField("the field's levels do not match its time schedule")
    numbers = [*header["centre"], header["scale"]]
    if not all(math.isfinite(n) for n in numbers) or header["scale"] <= 0:
        raise BadField("the field's frame is not finite")


def _surface(tensors: dict[str, Tensor]) -> QuadricSurface:
    sites = len(tensors["origin"])
    for name, shape in _QUADRICS.items():
        if not _is_finite_single(tensors[name], (sites, *shape)):
            raise BadField(f"the field's quadrics are damaged: {name}")
    count = tensors["count"]
    if sites == 0 or count.shape != (sites,) or count.dtype != torch.int64:
        raise BadField("the field's quadrics are damaged: count")
    if bool((tensors["radius"] <= 0).any()):
        raise BadField("the field's quadrics are damaged: a radius is not positive")
    return QuadricSurface.of(LocalQuadrics(**tensors))


def _level(described: dict[str, Any], coefficients: Tensor, cells: Tensor) -> SplineLevel:
    nx, ny, nz = (int(n) for n in described["shape"])
    spacing = float(described["spacing"])
    origin = torch.tensor(described["origin"], dtype=torch.float32, device=cells.device)
    if (
        not all(0 < n <= _MAX_LATTICE for n in (nx, ny, nz))
        or not (math.isfinite(spacing) and spacing > 0)
        or not _is_finite_single(origin, (3,))
    ):
        raise BadField("a level of the field claims an impossible grid")
    active = SparseLattice.from_distinct(_checked_cells(cells, (nx, ny, nz)), (nx, ny, nz))
    grid = SplineGrid(origin, spacing, active, active.dilated(1))
    if not _is_finite_single(coefficients, (len(grid.nodes),)):
        raise BadField("a level of the field has the wrong number of coefficients, or bad ones")
    return SplineLevel.of(grid, coefficients)


def _checked_cells(cells: Tensor, shape: tuple[int, int, int]) -> Tensor:
    """The cells as (c, 3) int64, all with a neighbour on every side inside the lattice."""
    if cells.dtype != torch.int16 or cells.ndim != 2 or cells.shape[1] != 3 or len(cells) == 0:
        raise BadField("a level of the field has no cells, or damaged ones")
    coordinates = cells.long()
    upper = torch.tensor(shape, device=cells.device) - 1
    if bool(((coordinates < 1) | (coordinates >= upper)).any()):
        raise BadField("a level of the field has cells outside its grid")
    return coordinates


def _is_finite_single(tensor: Tensor, shape: tuple[int, ...]) -> bool:
    return (
        tensor.shape == shape
        and tensor.dtype == torch.float32
        and bool(torch.isfinite(tensor).all())
    )
