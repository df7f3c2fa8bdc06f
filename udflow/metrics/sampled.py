"""Measures between two samples of surfaces: Chamfer distance, F-score, normal consistency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.metrics.surface import Samples


@dataclass(frozen=True)
class Agreement:
    """How two samples a and b agree; distances are those to the nearest sample of the other.

    Attributes:
        a_to_b, b_to_a: (n,) and (m,) distances.
        normals_a_to_b, normals_b_to_a: (n,) and (m,) |n . n'| with the nearest sample.
    """

    a_to_b: NDArray[np.float64]
    b_to_a: NDArray[np.float64]
    normals_a_to_b: NDArray[np.float64]
    normals_b_to_a: NDArray[np.float64]

    @property
    def chamfer_l1(self) -> float:
        """Half the sum of the mean distances both ways (not the L1 norm)."""
        return float(0.5 * (self.a_to_b.mean() + self.b_to_a.mean()))

    @property
    def chamfer_l2(self) -> float:
        """Half the sum of the mean squared distances both ways."""
        return float(0.5 * ((self.a_to_b**2).mean() + (self.b_to_a**2).mean()))

    @property
    def normal_consistency(self) -> float:
        """Mean |n . n'| both ways, 0..1."""
        return float(0.5 * (self.normals_a_to_b.mean() + self.normals_b_to_a.mean()))

    def f_score(self, threshold: float) -> float:
        """Harmonic mean of the shares within `threshold`, 0..1; 0 where nothing is within."""
        precision = float((self.a_to_b <= threshold).mean())
        recall = float((self.b_to_a <= threshold).mean())
        total = precision + recall
        return 2.0 * precision * recall / total if total > 0.0 else 0.0


def agreement(a: Samples, b: Samples, *, per_component: bool = False) -> Agreement:
    """Compare two samples by their nearest neighbours.

    Args:
        per_component: sum |n_i n'_i| over the components in place of |n . n'|. It is never
            smaller, so it flatters; kept for the one protocol that uses it.
    """
    a_to_b, in_b = cKDTree(b.points).query(a.points, workers=-1)
    b_to_a, in_a = cKDTree(a.points).query(b.points, workers=-1)
    return Agreement(
        a_to_b=np.asarray(a_to_b),
        b_to_a=np.asarray(b_to_a),
        normals_a_to_b=_alignment(a.normals, b.normals[in_b], per_component),
        normals_b_to_a=_alignment(b.normals, a.normals[in_a], per_component),
    )


def _alignment(
    m: NDArray[np.float64], n: NDArray[np.float64], per_component: bool
) -> NDArray[np.float64]:
    products = m * n
    if per_component:
        products = np.abs(products)
    return np.asarray(np.abs(products.sum(axis=1)))
