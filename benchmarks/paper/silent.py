"""What the paper leaves open, each with its switch: one change at a time.

python benchmarks/paper/silent.py --budget 1 --save
"""

from lab import Variant, run

NOTE = "The preset of the run, and one decision changed at a time. Equal time for each."
VARIANTS = [
    Variant("as it is"),
    Variant("sides left to chance", {"training": {"sided": 0}}),
    Variant("output relu", {"network": {"output": "relu"}}),
    Variant("output softplus", {"network": {"output": "softplus"}}),
    Variant("scale learned", {"network": {"scale": "learned"}}),
    Variant("start he", {"network": {"start": "he"}}),
    Variant("start sphere", {"network": {"start": "sphere"}}),
    Variant("adam", {"training": {"optimiser": "adam"}}),
    Variant("targets points", {"training": {"targets": "points"}}),
    Variant("spread 0.5", {"training": {"spread": 0.5}}),
    Variant("value term", {"training": {"value_weight": 1.0}}),
]

if __name__ == "__main__":
    run("paper_silent", "What the paper leaves open", NOTE, VARIANTS)
