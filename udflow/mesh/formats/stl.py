"""Binary STL: triangles in single precision, so around a shifted origin where needed."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh

_CHUNK = 100_000
_HEADER_BYTES = 80
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(file: BinaryIO, mesh: Mesh, *, comments: tuple[str, ...] = ()) -> None:
    """Write the triangles of a mesh whose coordinates suit single precision.

    STL knows no colours. Normals follow the order of the corners and say nothing about inside and
    outside: an open surface encloses nothing and cannot be printed as it is.
    """
    # A header that began with "solid" would be taken for ascii.
    header = " ".join(("udflow", *comments)).encode("ascii")[:_HEADER_BYTES]
    file.write(header.ljust(_HEADER_BYTES, b" "))
    file.write(len(mesh.faces).to_bytes(4, "little"))
    for start in range(0, len(mesh.faces), _CHUNK):
        corners = mesh.vertices[mesh.faces[start : start + _CHUNK]]
        facets = np.zeros(len(corners), _FACET)
        facets["corners"] = corners
        facets["normal"] = _normals(corners)
        file.write(facets.tobytes())


def _normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals (f, 3) of triangles (f, 3, 3), zero where a triangle has no area."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normals: NDArray[np.float64] = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)
