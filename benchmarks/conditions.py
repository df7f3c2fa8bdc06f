"""What can be wrong with a scan: each condition makes a scan from a ground truth and a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from common import scan_of
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.metrics.surface import bounds, sample

Array = NDArray[np.float64]
FULL = 30_000
PATCH = 1 / 8  # radius of what is missing, in largest extents


@dataclass(frozen=True)
class Condition:
    """One column of the benchmark.

    Attributes:
        about: what the scan is like, a phrase.
        scan: (points, 3) from the ground truth and a seed, in its units.
        patched: a ball of the scan is empty; see `patch`.
    """

    about: str
    scan: Callable[[Mesh, int], Array]
    patched: bool = False


def even(points: int, noise: float = 0.0) -> Callable[[Mesh, int], Array]:
    """Evenly by area; noise is the standard deviation in largest extents."""
    return lambda mesh, seed: scan_of(mesh, points, noise, seed)


def with_outliers(share: float, points: int = FULL) -> Callable[[Mesh, int], Array]:
    """A share of the points lies anywhere in the bounding box."""

    def scan(mesh: Mesh, seed: int) -> Array:
        found, generator = scan_of(mesh, points, 0.0, seed), np.random.default_rng(seed + 1)
        astray = round(share * points)
        low, high = found.min(axis=0), found.max(axis=0)
        found[:astray] = generator.uniform(low, high, (astray, 3))
        return found

    return scan


def uneven(mesh: Mesh, seed: int) -> Array:
    """FULL points, whose density falls tenfold along x."""
    generator = np.random.default_rng(seed)
    points = sample(mesh, 4 * FULL, generator).points
    place = (points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0])
    kept = generator.uniform(size=len(points)) < 10.0**-place
    return points[kept][:FULL]


def by_depth_cameras(mesh: Mesh, seed: int) -> Array:
    """FULL even points as four depth cameras around the shape would measure them.

    Each stands 1.5 extents from the centre and measures what is nearest to it. Errors lie along
    the line of sight and grow with the square of the depth z, as those of triangulation do:
    Gaussian, 0.2 % of the extent where z = 1.5, and depths fall into steps of 0.4 % there.
    """
    points, (centre, extent) = scan_of(mesh, FULL, 0.0, seed), bounds(mesh)
    around = 1.5 * extent * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    sight = points[:, None] - (centre + around)
    nearest = np.linalg.norm(sight, axis=2).argmin(axis=1)
    sight = sight[np.arange(len(points)), nearest]
    depth = np.linalg.norm(sight, axis=1) / extent
    grain = 0.004 / 1.5**2  # steps of the inverse depth
    noise = np.random.default_rng(seed + 1).normal(0.0, 0.5 * grain, len(points))
    measured = 1 / (grain * np.round((1 / depth + noise) / grain))
    return np.asarray(points + sight * (measured / depth - 1)[:, None])


def patch(mesh: Mesh, seed: int) -> tuple[Array, float]:
    """Centre (3,) and radius of the ball that `missing` leaves empty."""
    return scan_of(mesh, FULL, 0.0, seed)[0], PATCH * bounds(mesh)[1]


def missing(mesh: Mesh, seed: int) -> Array:
    """FULL even points without those in the ball of `patch`."""
    points = scan_of(mesh, FULL, 0.0, seed)
    centre, radius = patch(mesh, seed)
    return points[np.linalg.norm(points - centre, axis=1) > radius]


CONDITIONS = {
    "clean": Condition("30 000 points, evenly by area", even(FULL)),
    "noise-0.3": Condition("30 000, Gaussian noise of 0.3 % of the extent", even(FULL, 0.003)),
    "noise-0.5": Condition("30 000, Gaussian noise of 0.5 % of the extent", even(FULL, 0.005)),
    "points-5000": Condition("5 000 points", even(5_000)),
    "points-3000": Condition("3 000 points", even(3_000)),
    "uneven": Condition("30 000, density falling tenfold from end to end", uneven),
    "outliers-5": Condition("30 000, 5 % anywhere in the bounding box", with_outliers(0.05)),
    "missing": Condition("30 000, without a ball of an eighth of the extent", missing, True),
}
