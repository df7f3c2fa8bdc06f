"""One condition over all shapes against the starting marks: seconds, memory, excess.

    python benchmarks/starting_marks.py                      # all shapes, clean, 30 000 points
    python benchmarks/starting_marks.py --shapes spot boot --points 10000 --noise 0.001

The rows are those of bench.py; this script makes scans to order and judges by marks. Seconds and
memory are those of a whole cold process, start-up of Python and torch included.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import tables
from common import DATA, load, markdown, provenance, provenance_line, save, scan_of, shapes
from measuring import measured
from methods import CLASSICS, Settings, available, peers_python

CONDITIONS = {"clean": (30_000, 0.0), "noise": (30_000, 0.003), "sparse": (5_000, 0.0)}
MARK_SECONDS, MARK_MB, MARK_EXCESS = 30.0, 2048.0, 0.15
HEADER = (*tables.HEADER[:-1], "marks")


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    points, noise = CONDITIONS[options.condition]
    points = options.points if options.points is not None else points
    noise = options.noise if options.noise is not None else noise
    settings = Settings(options.resolution, tuple(options.set), options.samples, options.seed)
    python = peers_python(options.peers)
    methods = ["udflow", *(available(CLASSICS, python) if options.peers else ())]
    origin = provenance(condition=options.condition, points=points, noise=noise, **vars(settings))
    rows = []
    print(tables.aligned(HEADER))
    for name, file in shapes(options.data, options.shapes):
        truth = load(file)
        scan = scan_of(truth, points, noise, settings.seed)
        for method in methods:
            row: dict[str, Any] = {"shape": name, "condition": options.condition}
            row |= measured(method, truth, scan, settings, python)
            row["origin"] = _marks(row)
            rows.append(row)
            print(tables.aligned(tables.cells(row)), flush=True)
    if options.save:
        _publish(rows, origin, options.condition)


def _marks(row: dict[str, Any]) -> str:
    """What of the marks is missed, in words."""
    if "failed" in row:
        return "failed"
    missed = [] if row["seconds"] <= MARK_SECONDS else ["time"]
    missed += [] if row["peak_mb"] <= MARK_MB else ["memory"]
    if row["shape"].startswith("closed/") and row["excess"] > MARK_EXCESS:
        missed.append("excess")
    return f"missed: {', '.join(missed)}" if missed else "met"


def _publish(rows: list[dict[str, Any]], origin: dict[str, Any], condition: str) -> None:
    text = (
        f"# Starting marks, {condition}\n\n{tables.LEGEND}\n\n"
        f"Marks: {MARK_SECONDS:.0f} s and {MARK_MB:.0f} MB for the whole cold process; excess "
        f"below {MARK_EXCESS} on closed shapes.\n\n"
        f"{markdown(HEADER, [tables.cells(row) for row in rows])}\n{provenance_line(origin)}\n"
    )
    save(f"starting_marks_{condition}", {**origin, "rows": rows}, text)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with closed, cad, ...")
    parser.add_argument("--shapes", nargs="+", default=[], metavar="NAME", help="default: all")
    parser.add_argument("--condition", choices=CONDITIONS, default="clean")
    parser.add_argument("--points", type=int, help="in place of the condition's")
    parser.add_argument("--noise", type=float, help="sd in largest extents, in place of ...")
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=100_000, help="for the metrics")
    parser.add_argument(
        "--peers",
        nargs="?",
        const=peers_python(None),
        metavar="PYTHON",
        help="Open3D in the same table; a Python that has it, default: BENCH_PEERS or this one",
    )
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
