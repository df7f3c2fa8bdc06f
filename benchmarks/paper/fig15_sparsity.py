"""Fig. 15: 5 000, 3 000 and 1 000 points, densified to 30 000.

python benchmarks/paper/fig15_sparsity.py --budget 1 --save
"""

from lab import Variant, run

NOTE = "Densified in rounds of 2 000 points."
DENSIFY = {"densify": {"points_per_round": 2_000}}

if __name__ == "__main__":
    variants = [Variant(f"{n} points", DENSIFY, points=n) for n in (5_000, 3_000, 1_000)]
    run("paper_fig15_sparsity", "Fig. 15: sparsity", NOTE, variants)
