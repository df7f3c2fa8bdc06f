"""Table VI, architecture: depth L and width H.

python benchmarks/paper/table6_architecture.py --budget 1 --save
"""

from lab import Variant, run

PAPER = {
    (8, 128): ("2.001", "99.75", "98.46", "93.22"),
    (8, 256): ("1.982", "99.83", "98.43", "95.51"),
    (8, 512): ("1.971", "99.85", "98.46", "96.14"),
    (12, 128): ("1.930", "99.93", "98.48", "95.11"),
    (12, 256): ("1.913", "99.99", "98.57", "97.79"),
    (12, 512): ("1.914", "99.99", "98.64", "97.08"),
}
NOTE = "Every variant gets the same time, so that a larger network makes fewer iterations."


def variant(layers: int, width: int) -> Variant:
    """A network with skips and FiLM where the paper's has them."""
    places = [layer for layer in (4, 8) if layer < layers]
    network = {"layers": layers, "width": width, "skips": places, "film": [0, *places]}
    return Variant(f"L = {layers}, H = {width}", {"network": network}, paper=PAPER[layers, width])


if __name__ == "__main__":
    run("paper_table6_architecture", "Table VI: architecture", NOTE, [variant(*k) for k in PAPER])
