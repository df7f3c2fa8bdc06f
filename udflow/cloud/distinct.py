"""Which points of a cloud are distinct."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def distinct(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the distinct points, the first of each, in ascending order.

    Points are the same where all three coordinates are equal (-0.0 equals 0.0).

    Args:
        points: (n, 3).
    """
    order = np.lexsort(points.T)  # stable, so the first of equal points comes first
    ordered = points[order]
    fresh = np.ones(len(points), dtype=bool)
    fresh[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.sort(order[fresh])
