"""PLY, binary little-endian: coordinates in double precision, so map coordinates survive."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_CHUNK = 200_000
_SCALARS = {"f8": "double", "f4": "float", "u1": "uchar"}


def write_ply(
    file: BinaryIO,
    points: NDArray[np.float64],
    *,
    faces: NDArray[np.int64] | None = None,
    colors: NDArray[np.uint8] | None = None,
    normals: NDArray[np.float32] | None = None,
    comments: tuple[str, ...] = (),
) -> None:
    """Write vertices (n, 3), with faces (f, 3), sRGB colours (n, 3) and normals (n, 3) if given."""
    columns: list[tuple[str, str, NDArray[Any]]] = [("x y z", "<f8", points)]
    if normals is not None:
        columns.append(("nx ny nz", "<f4", normals))
    if colors is not None:
        columns.append(("red green blue", "u1", colors))
    head = ["ply", "format binary_little_endian 1.0"]
    head += [f"comment {comment}" for comment in ("udflow", *comments)]
    head.append(f"element vertex {len(points)}")
    for names, code, _ in columns:
        head += [f"property {_SCALARS[code.lstrip('<')]} {name}" for name in names.split()]
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    file.write(("\n".join([*head, "end_header"]) + "\n").encode("ascii"))
    _write_rows(file, columns)
    if faces is not None:
        _write_faces(file, faces)


def _write_rows(file: BinaryIO, columns: list[tuple[str, str, NDArray[Any]]]) -> None:
    dtype = np.dtype([(names, code, 3) for names, code, _ in columns])
    for start in range(0, len(columns[0][2]), _CHUNK):
        part = slice(start, start + _CHUNK)
        rows = np.empty(len(columns[0][2][part]), dtype)
        for names, _, values in columns:
            rows[names] = values[part]
        file.write(rows.tobytes())


def _write_faces(file: BinaryIO, faces: NDArray[np.int64]) -> None:
    dtype = np.dtype([("length", "u1"), ("corners", "<i4", 3)])
    for start in range(0, len(faces), _CHUNK):
        part = faces[start : start + _CHUNK]
        rows = np.empty(len(part), dtype)
        rows["length"] = 3
        rows["corners"] = part
        file.write(rows.tobytes())
