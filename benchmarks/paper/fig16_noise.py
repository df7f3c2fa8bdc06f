"""Fig. 16: Gaussian noise of 0.1, 0.3 and 0.5 per cent of the largest extent.

python benchmarks/paper/fig16_noise.py --budget 1 --save
"""

from lab import Variant, run

NOTE = "The paper does not say per cent of what; here it is the largest extent. 30 000 points."

if __name__ == "__main__":
    variants = [Variant(f"noise {n:.1%}", noise=n) for n in (0.001, 0.003, 0.005)]
    run("paper_fig16_noise", "Fig. 16: noise", NOTE, variants)
