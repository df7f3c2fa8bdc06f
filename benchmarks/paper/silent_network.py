"""What the paper leaves open about the network, each with its switch: one change at a time.

python benchmarks/paper/silent_network.py --budget 1 --save
"""

from lab import Variant, run

NOTE = (
    "The preset of the run, and one decision changed at a time: output activation, growth with "
    "time, first weights, width of the time's own network (FiLM)."
)
VARIANTS = [
    Variant("as it is"),
    *(Variant(f"output {kind}", {"network": {"output": kind}}) for kind in ("abs", "relu")),
    Variant("output softplus", {"network": {"output": "softplus"}}),
    *(Variant(f"scale {kind}", {"network": {"scale": kind}}) for kind in ("ideal", "learned")),
    *(Variant(f"start {kind}", {"network": {"start": kind}}) for kind in ("linear", "he")),
    Variant("start sphere", {"network": {"start": "sphere"}}),
    Variant("FiLM width 16", {"network": {"film_width": 16}}),
]

if __name__ == "__main__":
    run("paper_silent_network", "What the paper leaves open: the network", NOTE, VARIANTS)
