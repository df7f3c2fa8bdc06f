"""Every ground-truth shape: sampled, reconstructed in a fresh process, measured exactly.

    python benchmarks/starting_marks.py                      # all shapes, clean, 30 000 points
    python benchmarks/starting_marks.py --shapes spot boot --condition noise
    python benchmarks/starting_marks.py --peers              # with Open3D where it is installed

Seconds and memory are those of a whole cold process, start-up of Python and torch included.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import peers
from common import (
    DATA,
    cold,
    load,
    markdown,
    provenance,
    provenance_line,
    save,
    scan_of,
    shapes,
)

from udflow.errors import UdflowError
from udflow.mesh.load import read_mesh
from udflow.mesh.mesh import Mesh
from udflow.metrics import evaluate

CONDITIONS = {"clean": (30_000, 0.0), "noise": (30_000, 0.003), "sparse": (5_000, 0.0)}
MARK_SECONDS, MARK_MB, MARK_EXCESS = 30.0, 2048.0, 0.15
HEADER = (
    "shape", "method", "s", "MB", "mesh→GT", "GT→mesh", "excess", "NC % (floor)",
    "F .005 (floor)", "loops (GT)", "spur.", "non-m.", "parts (GT)", "Euler (GT)", "tight", "marks",
)  # fmt: skip
WIDTHS = (28, 13, 6, 5, 18, 18, 6, 14, 15, 11, 5, 6, 11, 11, 5, 8)


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    points, noise = CONDITIONS[options.condition]
    points = options.points if options.points is not None else points
    noise = options.noise if options.noise is not None else noise
    methods = ["udflow", *_peers(options.peers)]
    settings = {
        "condition": options.condition, "points": points, "noise": noise, "seed": options.seed,
        "resolution": options.resolution, "set": options.set, "samples": options.samples,
    }  # fmt: skip
    origin = provenance(**settings)
    rows = []
    print(_aligned(HEADER))
    for name, file in shapes(options.data, options.shapes):
        truth = load(file)
        scan = scan_of(truth, points, noise, options.seed)
        for method in methods:
            rows.append(measured(name, truth, scan, method, options))
            print(_aligned(_cells(rows[-1])), flush=True)
    if options.save:
        _publish(rows, origin, options.condition)


def measured(
    name: str, truth: Mesh, scan: np.ndarray[Any, Any], method: str, options: argparse.Namespace
) -> dict[str, Any]:
    """One row: reconstruct in a fresh process, then compare with the truth."""
    row: dict[str, Any] = {"shape": name, "method": method}
    with tempfile.TemporaryDirectory() as folder:
        cloud, mesh = Path(folder, "scan.npy"), Path(folder, "mesh.ply")
        np.save(cloud, scan, allow_pickle=False)
        run = cold(_command(method, cloud, mesh, options))
        row |= {"seconds": round(run.seconds, 2), "peak_mb": round(run.peak_mb)}
        if run.code != 0:
            return row | {"failed": run.errors.strip().splitlines()[-1:] or [str(run.code)]}
        try:
            found = evaluate(read_mesh(mesh), truth, samples=options.samples, seed=options.seed)
        except UdflowError as error:
            return row | {"failed": [str(error)]}
    return row | found.to_dict() | {"marks": _marks(name, run.seconds, run.peak_mb, found)}


def _command(method: str, cloud: Path, mesh: Path, options: argparse.Namespace) -> list[str]:
    if method != "udflow":
        return [options.peers, str(Path(peers.__file__)), method, str(cloud), str(mesh)]
    command = [sys.executable, "-m", "udflow", "reconstruct", str(cloud), "-o", str(mesh)]
    command += ["--quiet", "--seed", str(options.seed), "--resolution", str(options.resolution)]
    for assignment in options.set:
        command += ["--set", assignment]
    return command


def _marks(name: str, seconds: float, peak_mb: float, found: Any) -> dict[str, bool]:
    marks = {"time": seconds <= MARK_SECONDS, "memory": peak_mb <= MARK_MB}
    if name.startswith("closed/"):
        marks["excess"] = found.chamfer.excess <= MARK_EXCESS
    return marks


def _cells(row: dict[str, Any]) -> list[str]:
    cells = [row["shape"], row["method"], f"{row['seconds']:.1f}", f"{row['peak_mb']}"]
    if "failed" in row:
        return cells + [f"failed: {row['failed'][0]}"] + ["-"] * (len(HEADER) - len(cells) - 1)
    mesh, truth = row["topology"], row["reference_topology"]
    normals, f_score = row["normal_consistency"], row["f_score_005"]
    missed = [name for name, met in row["marks"].items() if not met]
    return [
        *cells,
        _distances(row["accuracy"]),
        _distances(row["completeness"]),
        f"{row['chamfer']['excess']:.3f}",
        f"{100 * normals['value']:.2f} ({100 * normals['floor']:.2f})",
        f"{f_score['value']:.4f} ({f_score['floor']:.4f})",
        f"{mesh['boundary_loops']} ({truth['boundary_loops']})",
        f"{row['spurious_boundary_edges']}",
        f"{mesh['nonmanifold_edges']}",
        f"{mesh['components']} ({truth['components']})",
        f"{mesh['euler_number']} ({truth['euler_number']})",
        "yes" if mesh["watertight"] else "no",
        f"missed: {', '.join(missed)}" if missed else "met",
    ]


def _distances(found: dict[str, float]) -> str:
    return f"{found['mean']:.3f}/{found['p95']:.3f}/{found['maximum']:.2f}"


def _aligned(cells: Sequence[str]) -> str:
    return " ".join(f"{cell:{width}}" for cell, width in zip(cells, WIDTHS, strict=True))


def _publish(rows: list[dict[str, Any]], origin: dict[str, Any], condition: str) -> None:
    text = (
        f"# Starting marks, {condition}\n\n"
        "mesh→GT and GT→mesh are exact distances, mean / 95 % / maximum; they and the excess L1 "
        "Chamfer distance are in 1e-3 of the ground truth's largest extent. NC is the normal "
        "consistency, F the F-score at 0.005, each beside what another sample of the ground truth "
        "scores. spur. are boundary edges far from true borders, non-m. non-manifold edges.\n\n"
        f"Marks: {MARK_SECONDS:.0f} s and {MARK_MB:.0f} MB for the whole cold process; excess "
        f"below {MARK_EXCESS} on closed shapes.\n\n"
        f"{markdown(HEADER, [_cells(row) for row in rows])}\n{provenance_line(origin)}\n"
    )
    save(f"starting_marks_{condition}", {**origin, "rows": rows}, text)


def _peers(python: str | None) -> list[str]:
    if python is None:
        return []
    if reason := peers.missing(python):
        print(reason, file=sys.stderr)
        return []
    return list(peers.METHODS)


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
        const=sys.executable,
        metavar="PYTHON",
        help="run Open3D in the same table; a Python that has it, default: this one",
    )
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
