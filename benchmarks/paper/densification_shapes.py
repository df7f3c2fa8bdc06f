"""Does densification from 5 000 points help? Shapes with and without, exact errors both ways.

    python benchmarks/paper/densification_shapes.py
    python benchmarks/paper/densification_shapes.py --resolution 48 --shapes --save

A quarter of an hour of one core; `--shapes` without names takes every shape, forty minutes.

"with" adds points up to 30 000 in rounds of the preset; everything else is the same. The mesh of
`fast` is the same with and without, since its field is not solved again. "teacher" is
the error of the quadrics of the 5 000 points by themselves, with no field and no mesh: how far the
feet of places near the true surface lie from it.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lab import DATA, load, markdown, provenance, provenance_line, save, scan_of, shapes

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, preset
from udflow.errors import UdflowError
from udflow.mesh.mesh import Mesh
from udflow.metrics import evaluate
from udflow.metrics.distances import MeshDistance
from udflow.metrics.surface import prepare, sample
from udflow.reconstruct import reconstruct

POINTS = 5_000
SOME = ["boot", "bunny_hr", "featuretype", "wingnut", "mountain", "plane_holes"]
NEAR = 0.003  # of the extent: how far from the true surface the teacher is asked
SAME = 0.01  # of the error: smaller changes are those of another seed
HEADER = (
    "shape", "teacher→GT", "mesh→GT w/o", "with", "GT→mesh w/o", "with", "half the sum w/o", "with",
    "change", "points", "s w/o", "with",
)  # fmt: skip


def main() -> None:
    """Every shape that is asked for twice, and a count."""
    options = _options()
    origin = provenance(preset=options.preset, iterations=options.iterations, seed=options.seed,
                        resolution=options.resolution, threads=torch.get_num_threads())  # fmt: skip
    rows = []
    print(" | ".join(HEADER))
    for name, file in shapes(options.data, options.shapes):
        truth = load(file)
        row = {"shape": name, "teacher": teacher_error(truth, options)} | {
            how: measured(truth, configured(options, how), options) for how in ("without", "with")
        }
        print(" | ".join(_cells(row)), flush=True)
        rows.append(row)
    print(_count(rows))
    if options.save:
        text = (
            f"# Densification of {POINTS} points, preset {options.preset}\n\nMean exact distances "
            f"in 1e-3 of the extent, {options.resolution}³.\n\n"
            f"{markdown(HEADER, [_cells(row) for row in rows])}\n{_count(rows)}\n\n"
            f"{provenance_line(origin)}\n"
        )
        save(f"paper_densification_{options.preset}", {**origin, "rows": rows}, text)


def configured(options: argparse.Namespace, how: str) -> Config:
    """The preset with or without densification."""
    config = dataclasses.replace(preset(options.preset), seed=options.seed)
    extract = dataclasses.replace(config.extract, extractor="edges", resolution=options.resolution)
    target = 30_000 if how == "with" else 0
    densify = dataclasses.replace(config.densify, target_points=target)
    training = dataclasses.replace(config.training, iterations=options.iterations)
    return dataclasses.replace(config, extract=extract, densify=densify, training=training)


def measured(truth: Mesh, config: Config, options: argparse.Namespace) -> dict[str, Any]:
    """Errors of one reconstruction, or why there is none."""
    scan = scan_of(truth, POINTS, 0.0, options.seed)
    start = time.process_time()
    try:
        result = reconstruct(PointCloud(scan), config)
    except UdflowError as error:
        return {"failed": str(error)}
    spent = time.process_time() - start
    found = evaluate(result.mesh, truth, samples=options.samples, seed=options.seed).to_dict()
    there, back = found["accuracy"]["mean"], found["completeness"]["mean"]
    return {
        "accuracy": there, "completeness": back, "error": 0.5 * (there + back),
        "points": len(result.points.points), "process_s": spent, "topology": found["topology"],
    }  # fmt: skip


def teacher_error(truth: Mesh, options: argparse.Namespace) -> float:
    """Mean exact distance of feet on the quadrics from the truth, 1e-3 of the extent."""
    frame = Normalisation.of(scan := scan_of(truth, POINTS, 0.0, options.seed))
    surface = SampledSurface.of(torch.from_numpy(np.unique(frame.to_unit(scan), axis=0)))
    generator = np.random.default_rng(options.seed + 1)
    places = frame.to_unit(sample(truth, options.samples, generator).points)
    places = places + generator.normal(0.0, NEAR, places.shape).astype(np.float32)
    feet = surface.project(torch.from_numpy(places)).double().numpy()
    exact = MeshDistance(prepare(truth, np.asarray(frame.centre), frame.scale))
    return 1e3 * float(exact(feet).mean())


def change(row: dict[str, Any]) -> float | None:
    """By what part densification changes half the sum of both errors; None where a run failed."""
    if any("failed" in row[how] for how in ("without", "with")):
        return None
    return float(row["with"]["error"] / row["without"]["error"] - 1)


def _count(rows: list[dict[str, Any]]) -> str:
    changes = [c for row in rows if (c := change(row)) is not None]
    better, worse = sum(c < -SAME for c in changes), sum(c > SAME for c in changes)
    return (
        f"Of {len(rows)} shapes {better} get better by more than {SAME:.0%}, {worse} worse, "
        f"{len(changes) - better - worse} stay the same; {len(rows) - len(changes)} failed."
    )


def _cells(row: dict[str, Any]) -> list[str]:
    changed = change(row)
    if changed is None:
        failed = [row[how].get("failed", "-") for how in ("without", "with")]
        return [row["shape"], f"{row['teacher']:.3f}", *failed, *["-"] * (len(HEADER) - 4)]
    pair = [row["without"], row["with"]]
    errors = [f"{p[key]:.3f}" for key in ("accuracy", "completeness", "error") for p in pair]
    return [
        row["shape"], f"{row['teacher']:.3f}", *errors, f"{changed:+.1%}",
        str(row["with"]["points"]), *(f"{p['process_s']:.0f}" for p in pair),
    ]  # fmt: skip


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--preset", default="neural")
    parser.add_argument("--iterations", type=int, default=1_000, help="of trained presets, in all")
    parser.add_argument("--shapes", nargs="*", default=SOME, metavar="NAME")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--resolution", type=int, default=48)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
