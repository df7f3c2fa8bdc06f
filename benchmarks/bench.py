"""Every method on every shape in every condition, in one table.

    python benchmarks/bench.py --save                     # all of it: hours
    python benchmarks/bench.py --shapes spot --conditions clean noise-0.3 --save
    python benchmarks/bench.py --methods udflow --save    # new rows of udflow alone
    python benchmarks/bench.py --only-new --save          # what the table does not have yet
    python benchmarks/bench.py --render                   # tables and chart from the JSON

Each run is a fresh process. With --save rows join those of docs/results/bench.json, so that the
whole can be made in several sittings; each row keeps its commit and its sitting.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import chart
import records
import tables
from common import DATA, RESULTS, ROOT, load, provenance, provenance_line, shapes
from conditions import CONDITIONS
from measuring import measured
from methods import METHODS, Settings, available, peers_python

Row = dict[str, Any]


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    settings = Settings(options.resolution, tuple(options.set), options.samples, options.seed)
    every = [name for name, _ in shapes(options.data, [])]
    book = _Book(options.name, settings, every)
    if not options.render:
        _run(options, settings, book)
    if options.save or options.render:
        book.publish()


class _Book:
    """The rows of a table and where they are kept."""

    def __init__(self, name: str, settings: Settings, every: list[str]) -> None:
        self.name, self.settings, self.every = name, settings, every
        self.file = RESULTS / f"{name}.json"

    def rows(self) -> dict[records.Key, Row]:
        return records.read(self.file, self.settings)

    def add(self, row: Row) -> None:
        """A row joins those in the file, which another sitting may have written meanwhile."""
        with records.alone(self.file):
            self._written(self.rows() | {records.key(row): row})

    def publish(self) -> None:
        with records.alone(self.file):
            rows = self._written(self.rows())
        publish(self.name, rows, RESULTS)
        print(f"wrote {(RESULTS / self.name).relative_to(ROOT)}.json, .md, _all.md and .svg")

    def _written(self, rows: dict[records.Key, Row]) -> list[Row]:
        order = list(CONDITIONS)
        return records.write(self.file, self.settings, rows.values(), self.every, order)


def _run(options: argparse.Namespace, settings: Settings, book: _Book) -> None:
    python = peers_python(options.peers)
    methods = available(options.methods, python)
    origin = provenance(**vars(settings))
    stamp = {"origin": f"{origin['commit']}, {origin['date'][:16]}", "sitting": origin["date"]}
    print(provenance_line(origin))
    print(tables.aligned(tables.HEADER))
    had = book.rows() if options.save or options.only_new else {}
    for name, file in shapes(options.data, options.shapes):
        truth = load(file)
        for condition in options.conditions:
            made = CONDITIONS[condition]
            wanted = [m for m in methods if not (options.only_new and (name, condition, m) in had)]
            scan = made.scan(truth, settings.seed)
            for method in wanted:
                row = {"shape": name, "condition": condition}
                row |= measured(method, truth, scan, settings, python, made.patched) | stamp
                print(tables.aligned(tables.cells(row)), flush=True)
                if options.save:
                    book.add(row)


def publish(name: str, rows: list[Row], folder: Path) -> None:
    """Write the summary, the table of everything and the charts."""
    if not rows:
        raise SystemExit(f"{name} has no rows yet; run some with --save first")
    commits = sorted({row["origin"].split(",")[0] for row in rows if row["method"] == "udflow"})
    missed = "\n".join(f"* {line}" for line in tables.misses(rows)) or "None."
    (folder / f"{name}.md").write_text(
        "# udflow beside the classics\n\n"
        f"{tables.LEGEND}\n\nPeers: see [benchmarks](../../benchmarks/README.md). Rows of udflow "
        f"are of commit {', '.join(commits)}. Every figure of every row: [{name}_all.md]"
        f"({name}_all.md).\n\n## Summary\n\nMedians over the shapes for which udflow has a row.\n\n"
        f"{tables.summary(rows)}\n## Errors\n\n![errors by shape and condition]({name}.svg)\n\n"
        "The least in bold. Missing patch, in brackets: without what lies in the hole, which "
        "udflow leaves open and Poisson fills.\n\n"
        f"{tables.errors(rows)}## What is missed\n\nShapes on which a classic is ahead, and marks "
        f"of the bunny that are not met.\n\n{missed}\n"
    )
    (folder / f"{name}_all.md").write_text(
        f"# Every figure\n\n{tables.LEGEND}\n\n{tables.everything(rows)}"
    )
    (folder / f"{name}.svg").write_text(_chart(rows))


def _chart(rows: list[Row]) -> str:
    panels: dict[str, dict[str, dict[str, float]]] = {}
    for (condition, shape), group in tables.grouped(rows).items():
        values = {method: tables.error(row) for method, row in group.items()}
        panels.setdefault(condition, {})[shape.split("/")[1]] = values
    ordered = {name: panels[name] for name in CONDITIONS if name in panels}
    return chart.dot_chart("Mean exact error, 1e-3 of the extent", ordered, METHODS, 2)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with closed, cad, ...")
    parser.add_argument("--shapes", nargs="+", default=[], metavar="NAME", help="default: all")
    parser.add_argument(
        "--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS), metavar="NAME",
        help=f"of {', '.join(CONDITIONS)}; default: all",
    )  # fmt: skip
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument(
        "--peers", metavar="PYTHON", help="one that has Open3D; default: BENCH_PEERS, or this one"
    )
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--samples", type=int, default=30_000, help="for the metrics")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--name", default="bench", help="of the files in docs/results")
    parser.add_argument("--only-new", action="store_true", help="rows that the table lacks")
    parser.add_argument("--save", action="store_true", help="join the rows of docs/results")
    parser.add_argument("--render", action="store_true", help="run nothing, write the tables")
    return parser.parse_args()


if __name__ == "__main__":
    main()
