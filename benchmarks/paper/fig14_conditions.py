"""Fig. 14: six hard conditions, made from one shape where the paper has scans of its own.

python benchmarks/paper/fig14_conditions.py --budget 1 --save
"""

from __future__ import annotations

import numpy as np
from lab import Variant, run
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.metrics.surface import bounds, sample

COUNT = 30_000
NOTE = (
    "Outliers: 1 % of the points anywhere in the bounding box. Disconnected: the shape and a copy "
    "half its size beside it. Non-uniform: density falls tenfold from end to end. High genus: "
    "`--shapes boot adis16480` (genus 12 and 24) in the even column. Noise: 0.5 % of the extent, "
    "in place of a real scanner's, which has no ground truth. Missing: all points within an eighth "
    "of the extent of one place are gone; the truth keeps them."
)


def even(mesh: Mesh, seed: int) -> NDArray[np.float64]:
    """COUNT points, evenly by area."""
    return sample(mesh, COUNT, np.random.default_rng(seed)).points


def outliers(mesh: Mesh, seed: int) -> NDArray[np.float64]:
    """One point in a hundred is anywhere in the bounding box."""
    points, generator = even(mesh, seed), np.random.default_rng(seed + 1)
    low, high = points.min(axis=0), points.max(axis=0)
    points[: COUNT // 100] = generator.uniform(low, high, (COUNT // 100, 3))
    return points


def uneven(mesh: Mesh, seed: int) -> NDArray[np.float64]:
    """Density falls tenfold along x."""
    generator = np.random.default_rng(seed)
    points = sample(mesh, 4 * COUNT, generator).points
    place = (points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0])
    kept = generator.uniform(size=len(points)) < 10.0**-place
    return points[kept][:COUNT]


def missing(mesh: Mesh, seed: int) -> NDArray[np.float64]:
    """A ball of an eighth of the extent is empty."""
    points = even(mesh, seed)
    return points[np.linalg.norm(points - points[0], axis=1) > bounds(mesh)[1] / 8]


def doubled(mesh: Mesh) -> Mesh:
    """The shape and a copy half its size beside it."""
    centre, extent = bounds(mesh)
    copy = centre + 0.5 * (mesh.vertices - centre) + np.array([1.1 * extent, 0.0, 0.0])
    faces = np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)])
    return Mesh(np.concatenate([mesh.vertices, copy]), faces)


VARIANTS = [
    Variant("even", scan=even),
    Variant("outliers", scan=outliers),
    Variant("disconnected", scan=even, truth=doubled),
    Variant("non-uniform", scan=uneven),
    Variant("noise 0.5%", noise=0.005),
    Variant("missing", scan=missing),
]

if __name__ == "__main__":
    run("paper_fig14_conditions", "Fig. 14: hard conditions", NOTE, VARIANTS)
