"""Fig. 13: CAP-UDF, CAP-UDF with this densification, and the paper's field, from 5 000 points.

python benchmarks/paper/fig13_cap_udf.py --budget 1 --save
"""

from lab import Variant, run

OFF, ON = {"target_points": 0}, {"target_points": 30_000, "points_per_round": 2_000}
NETWORK = {
    "layers": 8, "width": 256, "position_frequencies": 0, "start": "sphere", "skips": [4],
    "film": [],
}  # fmt: skip
CAP = {
    "field": "cap-udf",
    "network": NETWORK,
    "training": {"targets": "points", "optimiser": "adam", "learning_rate": 1e-3},
}
POINTS = {"training": {"targets": "points"}}
PER_POINT = CAP | {"training": {**CAP["training"], "pull_loss": "points"}}
NOTE = (
    "A field in the manner of CAP-UDF, written from its description (8 layers of 256, no weight "
    "normalisation), with its published loss, the Chamfer distance of unpaired sets, or pairs."
)
VARIANTS = [
    Variant("CAP-UDF", CAP | {"densify": OFF}, points=5_000),
    Variant("CAP-UDF, pairs", PER_POINT | {"densify": OFF}, points=5_000),
    Variant("CAP-UDF + densification", CAP | {"densify": ON}, points=5_000),
    Variant("CAP-UDF, pairs + densification", PER_POINT | {"densify": ON}, points=5_000),
    Variant("trajectory flow + densification", POINTS | {"densify": ON}, points=5_000),
]

if __name__ == "__main__":
    run("paper_fig13_cap_udf", "Fig. 13: densification for another field", NOTE, VARIANTS)
