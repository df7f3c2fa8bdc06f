"""A triangle mesh, the result of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mesh:
    """Triangles over shared vertices.

    Attributes:
        vertices: (v, 3) float64.
        faces: (f, 3) int64, indices into vertices. Orientation is consistent per component
            where the surface is orientable; it says nothing about inside and outside.
        colors: (v, 3) uint8 sRGB, or None.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None
