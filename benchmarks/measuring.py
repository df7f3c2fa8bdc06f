"""One row of a benchmark: a scan reconstructed in a fresh process, compared with the truth."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from common import cold
from conditions import patch
from methods import Settings, command
from numpy.typing import NDArray

from udflow.errors import UdflowError
from udflow.mesh.load import read_mesh
from udflow.mesh.mesh import Mesh
from udflow.metrics import Evaluation, evaluate
from udflow.metrics.distances import MeshDistance
from udflow.metrics.surface import bounds, sample

LIMIT_S = 900.0  # a method that takes longer has failed
DIGITS = 5

Row = dict[str, Any]
Scan = NDArray[np.float64]


def measured(
    method: str,
    truth: Mesh,
    scan: Scan,
    settings: Settings,
    python: str,
    patched: bool = False,
) -> Row:
    """Figures of one reconstruction, or `failed` with the reason; seconds in either case."""
    with tempfile.TemporaryDirectory() as folder:
        cloud, mesh = Path(folder, "scan.npy"), Path(folder, "mesh.ply")
        np.save(cloud, scan, allow_pickle=False)
        run = cold(command(method, cloud, mesh, settings, python), LIMIT_S)
        row: Row = {
            "method": method,
            "seconds": round(run.seconds, 2),
            "processor_s": round(run.processor_s, 2),
            "peak_mb": round(run.peak_mb),
        }
        if run.code != 0:
            return row | {"failed": _last_words(run.code, run.errors)}
        try:
            found = read_mesh(mesh)
            row |= figures(found, truth, settings)
            return row | ({"seen_error": seen_error(found, truth, settings)} if patched else {})
        except UdflowError as error:
            return row | {"failed": str(error)}


def figures(mesh: Mesh, truth: Mesh, settings: Settings) -> Row:
    """What the tables show of a mesh. Distances and excess in 1e-3 of the largest extent."""
    found = evaluate(mesh, truth, samples=settings.samples, seed=settings.seed)
    return rounded(flat(found)) | {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}


def flat(found: Evaluation) -> Row:
    """The evaluation without what follows from the settings."""
    normals, f_score = found.normal_consistency, found.f_score_005
    return {
        "error": 0.5 * (found.accuracy.mean + found.completeness.mean),
        "accuracy": asdict(found.accuracy),
        "completeness": asdict(found.completeness),
        "excess": found.chamfer.excess,
        "normals": {"value": normals.value, "floor": normals.floor},
        "f_score": {"value": f_score.value, "floor": f_score.floor},
        "topology": _kept(asdict(found.topology)),
        "true_topology": _kept(asdict(found.reference_topology)),
        "spurious": found.spurious_boundary_edges,
    }


def seen_error(mesh: Mesh, truth: Mesh, settings: Settings) -> float:
    """The mean exact error both ways without what lies in the empty ball of a patched scan.

    Whether a hole is filled or left open is a choice; this says what became of the rest.
    """
    centre, radius = patch(truth, settings.seed)
    sides = []
    for number, (one, other) in enumerate(((mesh, truth), (truth, mesh))):
        generator = np.random.default_rng([settings.seed, 100 + number])
        points = sample(one, settings.samples, generator).points
        outside = points[np.linalg.norm(points - centre, axis=1) > radius]
        sides.append(float(MeshDistance(other)(outside).mean()))
    return float(rounded(1e3 * 0.5 * sum(sides) / bounds(truth)[1]))


def rounded(value: Any) -> Any:
    """Floats of a JSON value with as many digits as mean something."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return value


def _kept(topology: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in topology.items() if key not in ("vertices", "faces")}


def _last_words(code: int, errors: str) -> str:
    if code == -9:
        return f"ended after {LIMIT_S:.0f} s, or for want of memory"
    return (errors.strip().splitlines() or [f"exit status {code}"])[-1]
