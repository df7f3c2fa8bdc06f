"""What the paper leaves open about training, each with its switch: one change at a time.

python benchmarks/paper/silent_training.py --budget 1 --save
"""

from lab import Variant, run

NOTE = (
    "The preset of the run, and one decision changed at a time: sides at the start, optimiser, "
    "where trajectories end, where queries are drawn, batch, a term for the value. Where a batch "
    "is larger there are fewer of them."
)
VARIANTS = [
    Variant("as it is"),
    Variant("sides left to chance", {"training": {"sided": 0}}),
    *(Variant(kind, {"training": {"optimiser": kind}}) for kind in ("muon", "adam")),
    *(Variant(f"targets {at}", {"training": {"targets": at}}) for at in ("quadrics", "points")),
    Variant("spread 0.5", {"training": {"spread": 0.5}}),
    *(Variant(f"batch {rows}", {"training": {"batch": rows}}) for rows in (2_000, 5_000)),
    Variant("value term", {"training": {"value_weight": 1.0}}),
]

if __name__ == "__main__":
    run("paper_silent_training", "What the paper leaves open: training", NOTE, VARIANTS)
