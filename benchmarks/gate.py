"""A clear loss of accuracy, found: figures against the limits in gates.toml.

    python benchmarks/gate.py                                # a few small scans, half a minute
    python benchmarks/gate.py --results docs/results/bench.json
    python benchmarks/gate.py --write                        # new limits from what is measured now
    python benchmarks/gate.py --results docs/results/bench.json --write

The exit status is 1 where a limit is passed. `--write` sets the limits of the small scans anew, or
with `--results` those of the bench: do so when the method became better, and say why in the commit
when it became worse.
"""

from __future__ import annotations

import argparse
import json
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common import DATA, load, shapes
from conditions import even, with_outliers
from made import MADE
from measuring import figures
from methods import Settings

from udflow.cloud.point_cloud import PointCloud
from udflow.config import from_dict
from udflow.mesh.mesh import Mesh
from udflow.reconstruct import reconstruct

Row = dict[str, Any]
Limits = dict[str, float]
GATES = Path(__file__).with_name("gates.toml")
POINTS = 4_000
SETTINGS = Settings(resolution=64, samples=10_000)
CONFIG = {"extract": {"resolution": SETTINGS.resolution}, "densify": {"target_points": 0}}
SHORT = {"iterations": 400, "batch": 1_000, "sided": 130, "warmup": 40, "queries": 40_000}
TRAINED = CONFIG | {"preset": "neural", "training": SHORT, "extract": {"resolution": 32}}
QUICK = {  # ground truth, scan, configuration
    "torus": ("torus", even(POINTS), CONFIG),
    "box": ("box", even(POINTS), CONFIG),
    "bowl": ("bowl", even(POINTS, 0.003), CONFIG),
    "cad/wingnut": ("cad/wingnut", even(POINTS), CONFIG),
    "torus, outliers": ("torus", with_outliers(0.05, POINTS), CONFIG),
    "torus, neural": ("torus", even(POINTS), TRAINED),
}
MARGIN = 0.15  # of a figure; a smaller loss is not clear
SPREAD = 0.5  # of a count that is not zero: those of torn surfaces change with every rounding
SLACK = {"error": 0.01, "excess": 0.0, "normals": 0.1}  # beside the margin, for figures near zero
SAMPLING = 1_000.0  # the excess is known to this over the number of samples, three deviations
COUNTS = {"loops": "boundary_loops", "parts": "components", "euler": "euler_number"}


def quick(name: str, data: Path) -> Row | None:
    """The figures of a small scan, or None where its ground truth is absent."""
    shape, scan, config = QUICK[name]
    truth = _truth(shape, data)
    if truth is None:
        return None
    cloud = PointCloud(scan(truth, SETTINGS.seed))
    mesh = reconstruct(cloud, from_dict(config)).mesh
    return figures(mesh, truth, SETTINGS)


def judged(row: Row) -> Limits:
    """The figures of a row that have limits, all of them the worse the larger.

    error and excess in 1e-3; normals: per cent below the floor; loops, parts, euler: how far from
    the ground truth's; spurious, nonmanifold: edges; leaky: 1 where the truth is watertight and
    the mesh is not.
    """
    mesh, truth = row["topology"], row["true_topology"]
    off = {name: float(abs(mesh[key] - truth[key])) for name, key in COUNTS.items()}
    return {
        "error": row["error"],
        "excess": row["excess"],
        "normals": 100 * (row["normals"]["floor"] - row["normals"]["value"]),
        **off,
        "spurious": float(row["spurious"]),
        "nonmanifold": float(max(mesh["nonmanifold_edges"] - truth["nonmanifold_edges"], 0)),
        "leaky": float(truth["watertight"] and not mesh["watertight"]),
    }


def limits(row: Row, samples: int) -> Limits:
    """Limits that this row keeps with a margin; a count that is zero must stay zero."""
    found = {name: _limit(name, value) for name, value in judged(row).items()}
    return found | {"excess": round(found["excess"] + SAMPLING / samples, 3)}


def _limit(name: str, value: float) -> float:
    if name in SLACK:
        return round(max(value, 0.0) * (1 + MARGIN) + SLACK[name], 3)
    return value if name == "leaky" else float(math.ceil(value * (1 + SPREAD)))


def losses(row: Row, allowed: Limits) -> list[str]:
    """What is clearly worse than allowed, in words."""
    if "failed" in row:
        return [f"no mesh: {row['failed']}"]
    return [
        f"{name} is {value:.3f}, limit {allowed[name]}"
        for name, value in judged(row).items()
        if value > allowed[name]
    ]


def gates() -> dict[str, dict[str, Limits]]:
    """The limits by kind (quick, bench) and name."""
    return tomllib.loads(GATES.read_text())


def main() -> None:
    """Judge what the command line asks for."""
    options = _options()
    kind = "bench" if options.results else "quick"
    rows = _bench_rows(options.results) if options.results else _quick_rows(options.data)
    if options.write:
        samples = _samples(options.results) if options.results else SETTINGS.samples
        made = {name: limits(row, samples) for name, row in rows if "failed" not in row}
        GATES.write_text(as_toml({**gates(), kind: made}))
        print(f"wrote {GATES.name}")
        return
    allowed = gates()[kind]
    lost = 0
    for name, row in rows:
        found = losses(row, allowed[name]) if name in allowed else ["no limit yet: use --write"]
        print(f"{name}: {'; '.join(found) or 'kept'}", flush=True)
        lost += bool(found)
    raise SystemExit(1 if lost else 0)


def as_toml(kinds: dict[str, dict[str, Limits]]) -> str:
    """What `gates` reads."""
    text = "# Written by `gate.py --write`. What each figure means: `judged` in gate.py.\n"
    for kind, made in kinds.items():
        for name, allowed in made.items():
            text += f'\n[{kind}."{name}"]\n'
            text += "".join(f"{key} = {value:g}\n" for key, value in allowed.items())
    return text


def _truth(name: str, data: Path) -> Mesh | None:
    if name in MADE:
        return MADE[name]()
    if not any((data / name.split("/")[0]).glob(f"{name.split('/')[1]}.*")):
        return None
    return load(shapes(data, [name])[0][1])


def _quick_rows(data: Path) -> Iterator[tuple[str, Row]]:
    for name in QUICK:
        row = quick(name, data)
        if row is None:
            print(f"{name}: skipped, no such shape under {data}")
        else:
            yield name, row


def _bench_rows(file: Path) -> Iterator[tuple[str, Row]]:
    for row in json.loads(file.read_text())["rows"]:
        if row["method"] == "udflow":
            yield f"{row['shape']} {row['condition']}", row


def _samples(file: Path) -> int:
    return int(json.loads(file.read_text())["settings"]["samples"])


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with closed, cad, ...")
    parser.add_argument("--results", type=Path, metavar="JSON", help="the rows of a bench")
    parser.add_argument("--write", action="store_true", help="set the limits anew")
    return parser.parse_args()


if __name__ == "__main__":
    main()
