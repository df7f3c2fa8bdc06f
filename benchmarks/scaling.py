"""Seconds and memory of large clouds and fine meshes, each in a fresh process.

python benchmarks/scaling.py --save                     # up to 3 000 000 points: some minutes
python benchmarks/scaling.py --sizes 30000:256 --shapes bunny_hr
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
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
from methods import Settings, command

from udflow.mesh.load import read_mesh
from udflow.mesh.mesh import Mesh

SIZES = ["30000:256", "300000:512", "3000000:512", "300000:1024"]
LIMIT_S = 1800.0
HEADER = ("shape", "points", "resolution", "s", "cpu s", "MB", "triangles")


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    origin = provenance(sizes=options.sizes, seed=options.seed)
    rows = []
    for name, file in shapes(options.data, options.shapes):
        truth = load(file)
        for size in options.sizes:
            rows.append({"shape": name} | measured(truth, size, options.seed))
            print(_cells(rows[-1]), flush=True)
    table = markdown(HEADER, [_cells(row) for row in rows])
    if options.save:
        text = (
            "# Large clouds and fine meshes\n\nEven samples without noise; whole fresh processes, "
            f"reading and writing included.\n\n{table}\n{provenance_line(origin)}\n"
        )
        save("scaling", {**origin, "rows": rows}, text)


def measured(truth: Mesh, size: str, seed: int) -> dict[str, Any]:
    """A reconstruction of "points:resolution" from outside."""
    points, resolution = (int(part) for part in size.split(":"))
    with tempfile.TemporaryDirectory() as folder:
        cloud, mesh = Path(folder, "scan.npy"), Path(folder, "mesh.ply")
        np.save(cloud, scan_of(truth, points, 0.0, seed), allow_pickle=False)
        settings = Settings(resolution, (), 0, seed)
        run = cold(command("udflow", cloud, mesh, settings, ""), LIMIT_S)
        if run.code != 0:
            raise SystemExit(f"{size}: {run.errors.strip() or f'exit status {run.code}'}")
        triangles = len(read_mesh(mesh).faces)
    return {
        "points": points,
        "resolution": resolution,
        "seconds": round(run.seconds, 1),
        "processor_s": round(run.processor_s, 1),
        "peak_mb": round(run.peak_mb),
        "triangles": triangles,
    }


def _cells(row: dict[str, Any]) -> list[str]:
    return [
        row["shape"],
        f"{row['points']:,}",
        f"{row['resolution']}³",
        f"{row['seconds']:.1f}",
        f"{row['processor_s']:.1f}",
        f"{row['peak_mb']:,}",
        f"{row['triangles']:,}",
    ]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with closed, cad, ...")
    parser.add_argument("--shapes", nargs="+", default=["bunny_hr"], metavar="NAME")
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="POINTS:RESOLUTION")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
