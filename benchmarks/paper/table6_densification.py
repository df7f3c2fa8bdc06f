"""Table VI, densification: 5 000 points, with and without, for the trained and the solved field.

python benchmarks/paper/table6_densification.py --budget 1 --save
"""

from lab import Variant, run

OFF, ON = {"target_points": 0}, {"target_points": 30_000, "points_per_round": 2_000}
AT_ONCE = {"target_points": 30_000, "points_per_round": 25_000}
PAPER = {"w/o": ("3.635", "96.22", "81.38", "94.66"), "with": ("3.154", "99.42", "87.79", "95.69")}
POINTS = {"training": {"targets": "points"}}
NOTE = (
    '2 000 points a round up to 30 000, epsilon 0.005. "points" are the paper\'s targets, the '
    'nearest sample; "quadrics" the nearest point of local quadrics of the measured points. "At '
    'once" adds all points in one round, with the iterations of all rounds after it.'
)


def pair(name: str, changes: dict) -> list[Variant]:
    """The same without and with densification."""
    return [
        Variant(f"{name}, {how}", changes | {"densify": densify}, points=5_000, paper=PAPER[how])
        for how, densify in (("w/o", OFF), ("with", ON))
    ]


VARIANTS = [
    *pair("points", POINTS),
    *pair("quadrics", {}),
    Variant("quadrics, at once", {"densify": AT_ONCE}, points=5_000),
    *pair("fast", {"field": "spline"}),
]

if __name__ == "__main__":
    run("paper_table6_densification", "Table VI: densification at 5 000 points", NOTE, VARIANTS)
