"""Fig. 12: the threshold epsilon of densification.

python benchmarks/paper/fig12_threshold.py --budget 1 --save
"""

from lab import Variant, run

NOTE = "5 000 points; no guard but epsilon, targets are the nearest samples, as in the paper."


def variant(threshold: float | None) -> Variant:
    """Densification with one threshold."""
    densify = {"threshold": threshold, "guard": "none", "points_per_round": 2_000}
    name = "off" if threshold is None else f"{threshold:g}"
    changes = {"densify": densify, "training": {"targets": "points"}}
    return Variant(f"epsilon {name}", changes, points=5_000)


if __name__ == "__main__":
    thresholds = (None, 0.001, 0.005, 0.01)
    run("paper_fig12_threshold", "Fig. 12: epsilon", NOTE, [variant(t) for t in thresholds])
