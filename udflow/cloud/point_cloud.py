"""The point cloud as it was uploaded: double precision, its own units and frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PointCloud:
    """Points with optional colours and normals.

    Attributes:
        points: (n, 3) float64, all finite, in the units and frame of the source.
        colors: (n, 3) uint8 sRGB, or None.
        normals: (n, 3) float32, as found in the source and never needed, or None.
        format: name of the format that was read, e.g. "ply".
        dropped: points left out because a coordinate was not finite.
        warnings: sentences for the user.
    """

    points: NDArray[np.float64]
    colors: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    format: str = "memory"
    dropped: int = 0
    warnings: tuple[str, ...] = ()
