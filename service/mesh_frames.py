"""The frame of a mesh that is downloaded: the scan's, or one near it for single precision."""

from __future__ import annotations

import json
import re
import struct
from functools import lru_cache
from pathlib import Path
from typing import Literal

from jobs.files import replacing
from udflow.cloud.formats import read_cloud
from udflow.cloud.shift import suggested_shift

Frame = Literal["world", "local"]
Vector = tuple[float, float, float]
_STL_SHIFT = re.compile(rb"shift (\S+) (\S+) (\S+)")
_STL_HEADER = 80


def stated_shift(path: Path) -> Vector | None:
    """What a stored GLB or STL file says was subtracted from its coordinates; None if nothing."""
    with path.open("rb") as file:
        if path.suffix == ".stl":
            found = _STL_SHIFT.search(file.read(_STL_HEADER))
            values = [float(text) for text in found.groups()] if found else []
        else:
            _, length = struct.unpack("<12sI4x", file.read(20))
            values = json.loads(file.read(length))["asset"]["extras"]["udflow"]["shift"]
    x, y, z = values or (0.0, 0.0, 0.0)
    return (x, y, z) if any((x, y, z)) else None


def local_copy(path: Path) -> Path:
    """The mesh of a stored PLY or OBJ file relative to the shift that GLB and STL take, which the
    copy states in a comment. Made once, beside the file; the file itself where no shift is needed.
    """
    shift = _shift_of(path)
    copy = path.with_name(f"local-{path.name}")
    if shift is None or copy.exists():
        return copy if shift is not None else path
    from udflow.mesh.export import write_mesh  # brings torch, which few requests need
    from udflow.mesh.load import read_mesh

    mesh = read_mesh(path)
    with replacing(copy) as temporary:
        write_mesh(mesh, temporary, shift=shift)
    return copy


@lru_cache(1024)
def _shift_of(path: Path) -> Vector | None:
    points = read_cloud(path).points
    return suggested_shift(points.min(axis=0), points.max(axis=0))
