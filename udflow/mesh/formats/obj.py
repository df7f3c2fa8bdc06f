"""Wavefront OBJ: text, coordinates with 16 digits."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.formats.numerals import decimals_for, fixed_point, lines, whole_numbers
from udflow.mesh.mesh import Mesh

_CHUNK = 50_000
_COLOR_DECIMALS = 4


def write_obj(file: BinaryIO, mesh: Mesh, *, comments: tuple[str, ...] = ()) -> None:
    """Write a mesh; colours follow the coordinates as fractions of 1, as MeshLab has it."""
    file.write("".join(f"# {comment}\n" for comment in ("udflow", *comments)).encode("ascii"))
    decimals = decimals_for(mesh.vertices)
    for start in range(0, len(mesh.vertices), _CHUNK):
        part = slice(start, start + _CHUNK)
        colors = None if mesh.colors is None else mesh.colors[part]
        file.write(_vertex_lines(mesh.vertices[part], colors, decimals))
    for start in range(0, len(mesh.faces), _CHUNK):
        file.write(lines(b"f", whole_numbers(mesh.faces[start : start + _CHUNK] + 1)))


def _vertex_lines(
    vertices: NDArray[np.float64], colors: NDArray[np.uint8] | None, decimals: int | None
) -> bytes:
    if decimals is None:  # astronomically large or small: written one by one
        return _slow_vertex_lines(vertices, colors)
    columns = [fixed_point(vertices, decimals)]
    if colors is not None:
        columns.append(fixed_point(colors / 255.0, _COLOR_DECIMALS))
    return lines(b"v", *columns)


def _slow_vertex_lines(vertices: NDArray[np.float64], colors: NDArray[np.uint8] | None) -> bytes:
    values = vertices if colors is None else np.hstack([vertices, colors / 255.0])
    return "".join("v " + " ".join(map(repr, row)) + "\n" for row in values.tolist()).encode()
