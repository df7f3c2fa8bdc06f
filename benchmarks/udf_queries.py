"""Distance queries a second, beside a KD-tree's nearest sample in the same run.

    python benchmarks/udf_queries.py --shapes spot scorpion --save

The KD-tree answers a simpler question (the distance to a sample, not to the surface); it is the
yardstick of speed, and its error shows what the field adds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import (
    DATA,
    load,
    markdown,
    provenance,
    provenance_line,
    save,
    scan_of,
    shapes,
)
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow import reconstruct as method
from udflow.cloud.point_cloud import PointCloud
from udflow.config import from_dict
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.mesh.mesh import Mesh
from udflow.metrics.distances import MeshDistance
from udflow.metrics.surface import Samples, bounds, sample

Array = NDArray[np.float64]
BAND = 0.01  # of the largest extent, to both sides of the surface
WIDE = 3.0  # extents: edge of the widest box that is asked
CHECKED = 5_000  # queries compared with the exact distance to the ground truth
TURNED = 1_000  # of them whose gradients are compared
STEP = 1e-5  # extents, of the differences that give the exact gradients
MEDIAL = 0.99  # length of such a gradient below which the query lies on the medial axis
HEADER = (
    "shape", "where", "field, queries/s", "KD-tree, queries/s", "ratio",
    "field error mean / 99 %", "KD-tree error mean / 99 %", "gradient off, median degrees (floor)",
)  # fmt: skip


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    origin = provenance(
        points=options.points, queries=options.queries, seed=options.seed,
        repeats=options.repeats, device=options.device, threads=torch.get_num_threads(),
    )  # fmt: skip
    rows = []
    for name, file in shapes(options.data, options.shapes):
        rows += timed(name, load(file), options)
    table = markdown(HEADER, [_cells(row) for row in rows])
    print(table)
    if options.save:
        text = (
            "# Distance queries\n\nErrors against exact distances to the ground truth, in 1e-3 of "
            f"its largest extent. In the band: within {BAND} of the surface. In the box: anywhere "
            f"in the bounding box. Wide: anywhere in a cube of {WIDE:.0f} extents. Gradients "
            "against differences of exact distances, but where two places of the surface are "
            "equally near; their floor is the true normal at the nearest of as many samples. "
            f"Best of {options.repeats} runs.\n\n{table}\n"
            f"{provenance_line(origin)}\n"
        )
        save("udf_queries", {**origin, "rows": rows}, text)


def timed(name: str, truth: Mesh, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Three rows: queries in the band, anywhere in the box, and anywhere around it."""
    scan = scan_of(truth, options.points, 0.0, options.seed)
    config = from_dict({"seed": options.seed})
    field = method.reconstruct(PointCloud(scan), config, device=options.device).field
    tree, exact = cKDTree(scan), MeshDistance(truth)
    extent = bounds(truth)[1]
    known = sample(truth, options.points, np.random.default_rng([options.seed, 2]))
    rows = []
    for where, queries in _queries(truth, extent, options).items():
        by_field, field_s = _best(lambda q=queries: field.query(q).distance, options.repeats)
        by_tree, tree_s = _best(lambda q=queries: tree.query(q, workers=-1)[0], options.repeats)
        true = exact(queries[:CHECKED])
        off, floor = _turned(field, exact, queries[:TURNED], extent, known)
        rows.append(
            {
                "shape": name,
                "where": where,
                "field_per_s": round(len(queries) / field_s),
                "kd_tree_per_s": round(len(queries) / tree_s),
                "ratio": tree_s / field_s,
                "field_error": _errors(by_field[:CHECKED], true, extent),
                "kd_tree_error": _errors(by_tree[:CHECKED], true, extent),
                "gradient_degrees": off,
                "gradient_floor": floor if where == "in the band" else None,
            }
        )
    return rows


def _queries(truth: Mesh, extent: float, options: argparse.Namespace) -> dict[str, Array]:
    generator = np.random.default_rng([options.seed, 1])
    near = sample(truth, options.queries, generator)
    offset = generator.uniform(-BAND, BAND, (options.queries, 1)) * extent
    low, high = truth.vertices.min(axis=0), truth.vertices.max(axis=0)
    return {
        "in the band": near.points + offset * near.normals,
        "in the box": generator.uniform(low, high, (options.queries, 3)),
        "wide": 0.5 * (low + high)
        + generator.uniform(-0.5, 0.5, (options.queries, 3)) * WIDE * extent,
    }


def _best(run: Callable[[], Array], repeats: int) -> tuple[Array, float]:
    """The answer and the seconds of the fastest of several runs."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        answer = run()
        seconds.append(time.perf_counter() - start)
    return answer, min(seconds)


def _turned(
    field: UnsignedDistanceField,
    exact: MeshDistance,
    queries: Array,
    extent: float,
    known: Samples,
) -> tuple[float, float]:
    """The median angles between exact gradients and the field's, and between them and the normals
    of the nearest known samples, degrees."""
    steps = STEP * extent * np.eye(3)
    true = np.stack([exact(queries + h) - exact(queries - h) for h in steps], axis=1)
    true /= 2 * STEP * extent
    length = np.linalg.norm(true, axis=1)
    clear = length > MEDIAL
    exactly = true[clear] / length[clear, None]
    nearest = cKDTree(known.points).query(queries[clear])[1]
    cosine = np.einsum("ij,ij->i", field.query(queries[clear]).gradient, exactly)
    floor = np.abs(np.einsum("ij,ij->i", known.normals[nearest], exactly))
    return _median_degrees(cosine), _median_degrees(floor)


def _median_degrees(cosine: Array) -> float:
    return float(np.median(np.degrees(np.arccos(cosine.clip(-1, 1)))))


def _errors(found: Array, true: Array, extent: float) -> dict[str, float]:
    error = 1e3 * np.abs(found - true) / extent
    return {"mean": float(error.mean()), "p99": float(np.percentile(error, 99))}


def _cells(row: dict[str, Any]) -> list[str]:
    return [
        row["shape"],
        row["where"],
        f"{row['field_per_s']:,}",
        f"{row['kd_tree_per_s']:,}",
        f"{row['ratio']:.2f}",
        *(f"{row[e]['mean']:.3f} / {row[e]['p99']:.3f}" for e in ("field_error", "kd_tree_error")),
        _with_floor(row["gradient_degrees"], row["gradient_floor"]),
    ]


def _with_floor(degrees: float, floor: float | None) -> str:
    return f"{degrees:.2f}" if floor is None else f"{degrees:.2f} ({floor:.2f})"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with closed, cad, ...")
    parser.add_argument("--shapes", nargs="+", default=["spot"], metavar="NAME")
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--queries", type=int, default=300_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
