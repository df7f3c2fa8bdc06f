"""Fig. 14: six hard conditions, made from one shape where the paper has scans of its own.

python benchmarks/paper/fig14_conditions.py --budget 1 --save
"""

from __future__ import annotations

import numpy as np
from lab import Variant, conditions, run
from made import sponge

from udflow.mesh.mesh import Mesh
from udflow.metrics.surface import bounds

COUNT = 30_000
NOTE = (
    "Outliers: 1 % of the points anywhere in the bounding box. Disconnected: the shape and a copy "
    "half its size beside it. Non-uniform: density falls tenfold from end to end. High genus: a "
    "cube drilled through and through (Menger's sponge, genus 81) in place of the shape. Real "
    "noise: that of four depth cameras, simulated, since real scans have no ground truth. "
    "Missing: all points within an eighth of the extent of one place are gone; the truth keeps "
    "them. Where points were lost (outliers, missing) densification adds some in a round of its "
    "own."
)


def doubled(mesh: Mesh) -> Mesh:
    """The shape and a copy half its size beside it."""
    centre, extent = bounds(mesh)
    copy = centre + 0.5 * (mesh.vertices - centre) + np.array([1.1 * extent, 0.0, 0.0])
    faces = np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)])
    return Mesh(np.concatenate([mesh.vertices, copy]), faces)


VARIANTS = [
    Variant("even", scan=conditions.even(COUNT)),
    Variant("outliers", scan=conditions.with_outliers(0.01)),
    Variant("disconnected", scan=conditions.even(COUNT), truth=doubled),
    Variant("non-uniform", scan=conditions.uneven),
    Variant("high genus", truth=lambda _: sponge()),
    Variant("depth cameras", scan=conditions.by_depth_cameras),
    Variant("missing", scan=conditions.missing),
]

if __name__ == "__main__":
    run("paper_fig14_conditions", "Fig. 14: hard conditions", NOTE, VARIANTS)
