"""Table VI, timesteps: K of the time schedule.

python benchmarks/paper/table6_steps.py --budget 1 --save
"""

from lab import Variant, run

PAPER = {
    1: ("2.121", "98.87", "97.22", "95.12"),
    3: ("1.967", "99.85", "97.64", "95.87"),
    5: ("1.913", "99.99", "98.57", "97.79"),
    10: ("1.912", "99.98", "98.54", "97.59"),
}
NOTE = "Does K > 1 help? Equal iterations and batches; a batch is shared by the K times."

if __name__ == "__main__":
    run(
        "paper_table6_steps",
        "Table VI: number of steps K",
        NOTE,
        [Variant(f"K = {k}", {"flow": {"steps": k}}, paper=PAPER[k]) for k in PAPER],
    )
