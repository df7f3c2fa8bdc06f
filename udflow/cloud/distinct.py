"""Which points of a cloud are distinct."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Distinct:
    """Points (n, 3) reduced to the u distinct ones.

    Attributes:
        first: (u,) index of the first of each, ascending.
        label: (n,) which of the distinct points each point is.
    """

    first: NDArray[np.int64]
    label: NDArray[np.int64]


def distinct(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the distinct points, the first of each, ascending.

    Points are the same where all three coordinates are equal (-0.0 equals 0.0).

    Args:
        points: (n, 3).
    """
    order, fresh = _sorted(points)
    return np.sort(order[fresh])


def distinct_labels(points: NDArray[np.float64]) -> Distinct:
    """The distinct points (n, 3) and, for every point, which of them it is."""
    order, fresh = _sorted(points)
    first = order[fresh]
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    label = np.empty(len(points), np.int64)
    label[order] = rank[np.cumsum(fresh) - 1]
    return Distinct(np.sort(first), label)


def _sorted(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """An order that brings equal points together, and where in it a new point begins."""
    order = np.lexsort(points.T)  # stable, so the first of equal points comes first
    ordered = points[order]
    fresh = np.ones(len(points), dtype=bool)
    fresh[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, fresh
