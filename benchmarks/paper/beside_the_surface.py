"""What a training has learned beside the surface after equal iterations, without any mesh.

    python benchmarks/paper/beside_the_surface.py --save
    python benchmarks/paper/beside_the_surface.py --shape spot --iterations 500

Points a little beside the true surface flow back by equation (4); "error" is how far from it they
arrive, exact, mean. "residual" is equation (3) in parts of what v* is: the root of
E ||v - v*||^2 / E ||v*||^2 over fresh trajectories. The sides' first iterations and K are among the
decisions that a mesh after a short training hides behind its lattice.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lab import DATA, load, markdown, provenance, provenance_line, save, scan_of, shapes
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, from_dict
from udflow.errors import UdflowError
from udflow.fields.mlp import MLPField
from udflow.fit.neural import NeuralFitting
from udflow.fit.queries import draw_trajectories
from udflow.flow.trajectory import interpolate
from udflow.mesh.mesh import Mesh
from udflow.metrics.distances import MeshDistance
from udflow.metrics.surface import prepare, sample

POINTS = 30_000
BESIDE = 0.003  # of the extent: standard deviation of the points asked about
FRESH = 20_000  # trajectories, and points asked about
HEADER = ("variant", "iterations", "residual", "error, 1e-3", "95 %")
VARIANTS: dict[str, dict[str, Any]] = {
    "as it is (K = 5)": {},
    "K = 1": {"flow": {"steps": 1}},
    "K = 2": {"flow": {"steps": 2}},
    "sides left to chance": {"training": {"sided": 0}},
    "sides left to chance, K = 1": {"flow": {"steps": 1}, "training": {"sided": 0}},
    "sides left to chance, Adam": {"training": {"sided": 0, "optimiser": "adam"}},
    "sides left to chance, start sphere": {
        "training": {"sided": 0},
        "network": {"start": "sphere"},
    },
    "output relu": {"network": {"output": "relu"}},
    "output softplus": {"network": {"output": "softplus"}},
}


def main() -> None:
    """Every variant, once."""
    options = _options()
    origin = provenance(shape=options.shape, iterations=options.iterations, seed=options.seed,
                        preset=options.preset, threads=torch.get_num_threads())  # fmt: skip
    ((name, file),) = shapes(options.data, [options.shape])
    truth = load(file)
    rows = []
    print(" | ".join(HEADER))
    for variant, changes in VARIANTS.items():
        config = from_dict({"preset": options.preset, "seed": options.seed, **changes})
        row = {"variant": variant, "iterations": options.iterations}
        row |= learned(truth, config, options.iterations)
        print(" | ".join(_cells(row)), flush=True)
        rows.append(row)
    if options.save:
        text = (
            f"# Beside the surface of {name}\n\nPreset {options.preset}, {POINTS:,} points, "
            f"{options.iterations:,} iterations for each; points {BESIDE} of the extent beside the "
            "true surface (standard deviation) flow back, and end so far from it.\n\n"
            f"{markdown(HEADER, [_cells(row) for row in rows])}\n{provenance_line(origin)}\n"
        )
        save("paper_beside_the_surface", {**origin, "rows": rows}, text)


def learned(truth: Mesh, config: Config, iterations: int) -> dict[str, Any]:
    """Figures of one training, or why there are none."""
    scan = scan_of(truth, POINTS, 0.0, config.seed)
    frame = Normalisation.of(scan)
    with torch.inference_mode():
        samples = torch.from_numpy(np.unique(frame.to_unit(scan), axis=0))
        surface = SampledSurface.of(samples)
        generator = torch.Generator().manual_seed(config.seed)
        fitting = NeuralFitting(samples, surface, config, iterations, None, generator)
        try:
            for _ in fitting.run():
                pass
        except UdflowError as error:
            return {"failed": str(error)}
        field = fitting.early().field
        assert isinstance(field, MLPField)
        residual = _residual(field, samples, surface, config)
        rng = np.random.default_rng(config.seed + 1)
        places = frame.to_unit(sample(truth, FRESH, rng).points)
        places = places + rng.normal(0.0, BESIDE, places.shape).astype(np.float32)
        feet = field.project(torch.from_numpy(places)).double().numpy()
    exact = 1e3 * MeshDistance(prepare(truth, np.asarray(frame.centre), frame.scale))(feet)
    return {"residual": residual, "error": float(exact.mean()),
            "p95": float(np.quantile(exact, 0.95))}  # fmt: skip


def _residual(field: MLPField, samples: Tensor, surface: SampledSurface, config: Config) -> float:
    """Root of E ||v - v*||^2 / E ||v*||^2 over fresh trajectories and all times."""
    few = dataclasses.replace(config.training, queries=FRESH)
    ends = draw_trajectories(samples, surface, few, torch.Generator().manual_seed(config.seed + 1))
    ideal = ends.query - ends.foot
    missed = [
        field.velocity(interpolate(ends.query, ends.foot, torch.full((len(ends), 1), t)), t) - ideal
        for t in field.schedule.times
    ]
    total = torch.stack([m.square().sum() for m in missed]).mean()
    return float((total / ideal.square().sum()).sqrt())


def _cells(row: dict[str, Any]) -> list[str]:
    start = [row["variant"], str(row["iterations"])]
    if "failed" in row:
        return [*start, f"failed: {row['failed']}", "-", "-"]
    return [*start, f"{row['residual']:.3f}", f"{row['error']:.3f}", f"{row['p95']:.3f}"]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--preset", default="neural")
    parser.add_argument("--shape", default="bunny_hr", metavar="NAME")
    parser.add_argument("--iterations", type=int, default=1_000)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
