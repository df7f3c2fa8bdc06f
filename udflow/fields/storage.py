"""Fitted fields as safetensors: no pickle, every value checked on the way in."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.quadric_surface import QuadricSurface
from udflow.cloud.quadrics import LocalQuadrics
from udflow.errors import BadField, OutdatedField
from udflow.fields.cap_udf import CapUdfField
from udflow.fields.interface import FittedField
from udflow.fields.lattice import SparseLattice
from udflow.fields.mlp import MLPField
from udflow.fields.spline import SplineField, SplineGrid, SplineLevel
from udflow.fields.trained_storage import TRAINED_FORMAT, trained_field, trained_parts
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.flow.schedule import TimeSchedule

FORMAT = "udflow-spline-field"
VERSION = 2
_LEVEL = ("coefficients", "cells", "faithful")
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
    """The field as the bytes of a safetensors file.

    Raises:
        TypeError: a field of a kind that has no format.
    """
    if isinstance(field.fitted, SplineField):
        tensors, header = spline_parts(field.fitted)
    elif isinstance(field.fitted, MLPField | CapUdfField):
        tensors, header = trained_parts(field.fitted)
    else:
        raise TypeError(f"no format for fields of the kind {type(field.fitted).__name__}")
    for name in _QUADRICS:
        tensors[f"quadrics.{name}"] = getattr(field.surface.quadrics, name).cpu().contiguous()
    tensors["quadrics.count"] = field.surface.quadrics.count.cpu().contiguous()
    header |= {
        "version": VERSION,
        "centre": field.normalisation.centre,
        "scale": field.normalisation.scale,
    }
    return to_bytes(tensors, metadata={"udflow": json.dumps(header)})


def spline_parts(spline: SplineField) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and header of a spline field."""
    tensors: dict[str, Tensor] = {}
    levels: list[dict[str, Any]] = []
    for i, level in enumerate(spline.levels):
        grid = level.grid
        tensors[f"level{i}.coefficients"] = level.coefficients.cpu().contiguous()
        tensors[f"level{i}.faithful"] = level.faithful.cpu().contiguous()
        tensors[f"level{i}.cells"] = grid.cells.coordinates.to(torch.int16).cpu().contiguous()
        levels.append(
            {"origin": grid.origin.tolist(), "spacing": grid.spacing, "shape": grid.cells.shape}
        )
    return tensors, {"format": FORMAT, "steps": spline.schedule.steps, "levels": levels}


def save_field(field: UnsignedDistanceField, path: Path) -> None:
    """Writes the field to `path`."""
    path.write_bytes(field_to_bytes(field))


def load_field(path: Path, device: str = "cpu") -> UnsignedDistanceField:
    """Reads a field written by `save_field`.

    Raises:
        BadField: not such a file, or damaged.
        OutdatedField: of a version this release does not read.
        FileNotFoundError: no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no field at {path}")
    try:
        with safe_open(str(path), framework="pt", device=device) as file:
            header = json.loads((file.metadata() or {}).get("udflow", "{}"))
            _check_header(header)
            fitted = _fitted(header, file.get_tensor)
            surface = _surface(
                {name: file.get_tensor(f"quadrics.{name}") for name in (*_QUADRICS, "count")}
            )
        x, y, z = (float(c) for c in header["centre"])
        normalisation = Normalisation((x, y, z), float(header["scale"]))
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
    return UnsignedDistanceField(fitted, surface, normalisation)


def _fitted(header: dict[str, Any], tensor: Callable[[str], Tensor]) -> FittedField:
    """The field that a header describes; `tensor` reads one by name."""
    if header["format"] == TRAINED_FORMAT:
        return trained_field(header, tensor("parameters"))
    return spline_from(header, tensor)


def spline_from(header: dict[str, Any], tensor: Callable[[str], Tensor]) -> SplineField:
    """The inverse of `spline_parts`; `tensor` reads one by name.

    Raises:
        BadField: values that cannot be.
    """
    levels = tuple(
        _level(described, *(tensor(f"level{i}.{name}") for name in _LEVEL))
        for i, described in enumerate(header["levels"])
    )
    return SplineField(TimeSchedule(int(header["steps"])), levels)


def _check_header(header: Any) -> None:
    formats = (FORMAT, TRAINED_FORMAT)
    if not isinstance(header, dict) or header.get("format") not in formats:
        raise BadField("the file holds no udflow field; fit one with udflow reconstruct --field")
    if header.get("version") != VERSION:
        raise OutdatedField(
            f"the field has version {header.get('version')}, this release reads {VERSION}; "
            "fit it again"
        )
    if header["format"] == FORMAT and not 0 < len(header["levels"]) == header["steps"]:
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


def _level(
    described: dict[str, Any], coefficients: Tensor, cells: Tensor, faithful: Tensor
) -> SplineLevel:
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
    if faithful.shape != (len(active),) or faithful.dtype != torch.bool:
        raise BadField("a level of the field does not say which of its cells are faithful")
    return SplineLevel.of(grid, coefficients, faithful)


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
