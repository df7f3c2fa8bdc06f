"""What every experiment needs: variants, a budget of training time, one table, one picture."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import conditions as conditions
from common import DATA, RESULTS, load, markdown, provenance, provenance_line, save, scan_of, shapes
from made import MADE

from udflow import picture
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, from_dict, preset, to_dict
from udflow.errors import UdflowError
from udflow.fit.neural import NeuralFitting
from udflow.mesh.mesh import Mesh
from udflow.metrics import evaluate
from udflow.png import png
from udflow.reconstruct import Reconstruction, reconstruct

Scan = Callable[[Mesh, int], NDArray[np.float64]]
Paper = tuple[str, str, str, str]  # L1-CD e-3, FS 0.01 %, FS 0.005 %, NC %
UNKNOWN: Paper = ("-", "-", "-", "-")
_TRIAL = 16  # iterations timed to know what a budget buys
_FEWER_QUERIES = 200_000  # drawing as many as for a whole training would take a third of a minute
_PANEL = (360, 360)
HEADER = (
    "shape", "variant", "iterations", "s/it", "points", "mesh→GT", "GT→mesh", "L1-CD (floor)",
    "FS .01 (floor)", "FS .005 (floor)", "NC % (floor)", "parts", "loops",
    "paper*: L1-CD", "FS .01", "FS .005", "NC",
)  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One row of a table.

    Attributes:
        name: what is different.
        changes: of the configuration, as `--set` would take them, nested.
        points, noise: of the scan: samples and standard deviation in largest extents.
        scan: makes the scan from the mesh and a seed, in place of even samples.
        paper: what the paper reports for its own shapes.
        truth: the shape that is reconstructed and compared with, in place of the file's.
    """

    name: str
    changes: dict[str, Any] = field(default_factory=dict)
    points: int = 30_000
    noise: float = 0.0
    scan: Scan | None = None
    paper: Paper = UNKNOWN
    truth: Callable[[Mesh], Mesh] = lambda mesh: mesh


def run(name: str, title: str, note: str, variants: Sequence[Variant]) -> None:
    """Reconstruct every shape in every variant, print the table, save it where asked."""
    options = _options(title)
    files = shapes(options.data, options.shapes)
    variants = distinct(variants, options)
    origin = provenance(
        budget="full" if options.full else f"{options.budget:g} min of training a run",
        preset=options.preset, resolution=options.resolution, seed=options.seed,
        samples=options.samples, threads=torch.get_num_threads(),
    )  # fmt: skip
    rows, panels = [], []
    print(" | ".join(HEADER))
    for shape, file in files:
        truth = load(file)
        for variant in variants:
            row, mesh = measured(shape, variant.truth(truth), variant, options)
            print(" | ".join(_cells(row)), flush=True)
            rows.append(row)
            panels.append(mesh if mesh is None else upright(shape, mesh))
    if options.save:
        _publish(name, title, note, rows, origin)
        picture_of(name, panels, len(variants))


def measured(
    shape: str, truth: Mesh, variant: Variant, options: argparse.Namespace
) -> tuple[dict[str, Any], Mesh | None]:
    """One reconstruction and its figures."""
    config = configured(variant, options)
    make = variant.scan or (lambda mesh, seed: scan_of(mesh, variant.points, variant.noise, seed))
    scan = make(truth, options.seed)
    if not options.full:
        config = within(config, 60 * options.budget)
    row: dict[str, Any] = {"shape": shape, "variant": variant.name, "paper": variant.paper}
    row["config"] = to_dict(config)
    start = time.process_time()
    try:
        result = reconstruct(PointCloud(scan), config, device=options.device)
        found = evaluate(result.mesh, truth, samples=options.samples, seed=options.seed)
    except UdflowError as error:
        return row | {"failed": str(error)}, None
    row |= {"process_s": round(time.process_time() - start, 1), "report": result.report}
    return row | found.to_dict() | {"s_per_iteration": _per_iteration(result)}, result.mesh


def distinct(variants: Sequence[Variant], options: argparse.Namespace) -> list[Variant]:
    """The variants without those that are an earlier one: to set what a preset has already."""
    found: dict[tuple[Any, ...], Variant] = {}
    for v in variants:
        found.setdefault((configured(v, options), v.points, v.noise, v.scan, v.truth), v)
    return list(found.values())


def configured(variant: Variant, options: argparse.Namespace) -> Config:
    """The preset with the variant's changes and the resolution of this run."""
    values = {"preset": options.preset, "seed": options.seed, **variant.changes}
    if not options.full:
        extract = {"extractor": "edges", **values.get("extract", {})}
        values["extract"] = {**extract, "resolution": options.resolution}
    return from_dict(values)


def within(config: Config, seconds: float) -> Config:
    """The configuration with as many iterations as fit into some seconds of training.

    Configurations whose iterations cost the same get equally many. A training that guessed sides
    all the while ends before it has a surface: short ones do without.
    """
    if config.field == "spline":
        return config
    iterations = max(int(seconds / seconds_per_iteration(cost_of(config))), 100)
    training = dataclasses.replace(
        config.training,
        iterations=iterations,
        warmup=min(config.training.warmup, iterations // 10),
        sided=config.training.sided if iterations >= 2 * config.training.sided else 0,
        queries=min(config.training.queries, _FEWER_QUERIES),
    )
    return dataclasses.replace(config, training=training)


def cost_of(config: Config) -> Config:
    """What an iteration costs depends on: all else is that of the preset `neural`."""
    plain = preset("neural")
    network = dataclasses.replace(
        config.network,
        output=plain.network.output,
        scale=plain.network.scale,
        start=plain.network.start,
    )
    training = dataclasses.replace(
        plain.training,
        batch=config.training.batch,
        optimiser=config.training.optimiser,
        pull_loss=config.training.pull_loss,
        precision=config.training.precision,
    )
    return dataclasses.replace(plain, field=config.field, network=network, training=training)


@functools.cache
def seconds_per_iteration(config: Config) -> float:
    """Median process seconds of an iteration."""
    samples = torch.from_numpy(scan_of(MADE["torus"](), 2_000, 0.0, 0).astype(np.float32))
    small = dataclasses.replace(config.training, queries=20_000)
    with torch.inference_mode():
        fitting = NeuralFitting(
            samples, SampledSurface.of(samples), dataclasses.replace(config, training=small),
            _TRIAL, None, torch.Generator().manual_seed(0),
        )  # fmt: skip
        return timed(fitting.trainer._advance, _TRIAL)


def timed(step: Callable[[], object], count: int) -> float:
    """Median process seconds of a step, threads counted once."""
    step()
    seconds = []
    for _ in range(count):
        start = time.process_time()
        step()
        seconds.append(time.process_time() - start)
    return float(np.median(seconds)) / torch.get_num_threads()


def picture_of(name: str, panels: Sequence[Mesh | None], columns: int) -> None:
    """docs/results/<name>.png: the meshes, one row a shape and one column a variant."""
    images = [_panel(mesh) for mesh in panels]
    rows = [np.hstack(images[i : i + columns]) for i in range(0, len(images), columns)]
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.png").write_bytes(png(np.ascontiguousarray(np.vstack(rows))))


def upright(shape: str, mesh: Mesh) -> Mesh:
    """The mesh as pictures take it, z up; the closed shapes have y up."""
    if not shape.startswith("closed/"):
        return mesh
    x, y, z = mesh.vertices.T
    return dataclasses.replace(mesh, vertices=np.column_stack([x, -z, y]))


def _panel(mesh: Mesh | None) -> NDArray[np.uint8]:
    """A mesh on white; white alone where there is none."""
    panel = np.full((*_PANEL[::-1], 4), 255, dtype=np.uint8)
    if mesh is not None:
        drawn = picture.mesh_picture(mesh, _PANEL).astype(np.float64)
        cover = drawn[..., 3:] / 255
        panel[..., :3] = np.rint(cover * drawn[..., :3] + (1 - cover) * 255)
    return panel


def _per_iteration(result: Reconstruction) -> float:
    config = result.report["config"]
    if config["field"] == "spline":
        return 0.0
    spent = sum(result.report["seconds"].get(stage, 0.0) for stage in ("fitting", "densifying"))
    return round(spent / config["training"]["iterations"], 4)


def _cells(row: dict[str, Any]) -> list[str]:
    training = (
        row["config"]["training"]["iterations"] if row["config"]["field"] != "spline" else "-"
    )
    start = [row["shape"], row["variant"], str(training)]
    if "failed" in row:
        blank = len(HEADER) - len(start) - 1 - len(row["paper"])
        return [*start, f"failed: {row['failed']}", *["-"] * blank, *row["paper"]]
    chamfer, normals = row["chamfer"], row["normal_consistency"]
    return [
        *start,
        f"{row['s_per_iteration']:.3f}",
        str(row["report"]["points"]["densified"]),
        f"{row['accuracy']['mean']:.2f}",
        f"{row['completeness']['mean']:.2f}",
        f"{chamfer['value']:.3f} ({chamfer['floor']:.3f})",
        *(
            f"{100 * row[key]['value']:.2f} ({100 * row[key]['floor']:.2f})"
            for key in ("f_score_010", "f_score_005")
        ),
        f"{100 * normals['value']:.2f} ({100 * normals['floor']:.2f})",
        str(row["topology"]["components"]),
        str(row["topology"]["boundary_loops"]),
        *row["paper"],
    ]


def _publish(
    name: str, title: str, note: str, rows: list[dict[str, Any]], origin: dict[str, Any]
) -> None:
    text = (
        f"# {title}\n\n{note}\n\n"
        f"Budget: **{origin['settings']['budget']}**. mesh→GT and GT→mesh are mean exact distances "
        "and L1-CD the Chamfer distance, in 1e-3 of the ground truth's largest extent; what "
        "another sample of the ground truth scores stands in brackets. s/it counts wall time, all "
        f"else of the fit included. With a budget no more than {_FEWER_QUERIES:,} queries are "
        "drawn. Variants whose iterations cost the same make equally many.\n\n"
        f"{markdown(HEADER, [_cells(row) for row in rows])}\n"
        "\\* The paper's figures are for **other shapes**, which it does not name, at 60 000 "
        "iterations on a GPU: context, not a ranking.\n\n"
        f"{_legend(rows)}\n\n![the meshes]({name}.png)\n\n"
        f"{provenance_line(origin)}\n"
    )
    save(name, {**origin, "rows": rows}, text)


def _legend(rows: list[dict[str, Any]]) -> str:
    """What the picture shows, read like its panels."""
    names = list(dict.fromkeys(row["shape"] for row in rows))
    variants = list(dict.fromkeys(row["variant"] for row in rows))
    return (
        f"The meshes, from left to right: {'; '.join(variants)}. From top to bottom: "
        f"{', '.join(names)}. White where a run failed."
    )


def _options(title: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--budget", type=float, default=1.0, metavar="MINUTES",
                        help="of training, processor time of a thread, for each run")  # fmt: skip
    parser.add_argument("--full", action="store_true", help="the paper's preset, 256³, no budget")
    parser.add_argument("--preset", default="neural")
    parser.add_argument("--shapes", nargs="+", default=["spot"], metavar="NAME")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--samples", type=int, default=20_000, help="for the metrics")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--save", action="store_true", help="write docs/results")
    options = parser.parse_args()
    if options.full:
        options.preset = "paper"
    preset(options.preset)
    return options
