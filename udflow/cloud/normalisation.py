"""The similarity between the frame of the upload ("world") and the unit cube ("unit")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Normalisation:
    """unit = (world - centre) / scale.

    Attributes:
        centre: centre of the bounding box in world units (double precision: map coordinates
            survive).
        scale: largest extent of the bounding box in world units, > 0.
    """

    centre: tuple[float, float, float]
    scale: float

    @classmethod
    def of(cls, points: NDArray[np.float64]) -> Normalisation:
        """The normalisation that centres (n, 3) world points and gives them largest extent 1."""
        low, high = points.min(axis=0), points.max(axis=0)
        x, y, z = (0.5 * (low + high)).tolist()
        return cls(centre=(x, y, z), scale=float((high - low).max()))

    def to_unit(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """World points (n, 3) to unit points; subtracts in double before rounding."""
        return ((points - np.asarray(self.centre)) / self.scale).astype(np.float32)

    def to_world(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Unit points (n, 3) to world points in double precision."""
        return points.astype(np.float64) * self.scale + np.asarray(self.centre)
