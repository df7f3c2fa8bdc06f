"""The three evaluators published with CAP-UDF, which differ in scale, for comparison with tables.

They were read in github.com/junshengzhou/CAP-UDF, folder `evaluation/`. Their predictions live
in the unit cube and are scaled back first; ours are in the frame of the reference already.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.errors import EmptySurface
from udflow.mesh.mesh import Mesh
from udflow.metrics.sampled import Agreement, agreement
from udflow.metrics.surface import Samples, bounds, sample

PROTOCOLS = ("capudf-cars", "capudf-srb", "capudf-3dscene")
SCENE_CROP = 0.008  # of the scan's largest extent


@dataclass(frozen=True)
class ProtocolResult:
    """Figures as that evaluator prints them.

    Attributes:
        figures: value by name; the name states the factor, e.g. "chamfer-L2 x 1e4".
        note: scale and units.
    """

    protocol: str
    figures: dict[str, float]
    note: str


def evaluate_protocol(
    mesh: Mesh,
    reference: Mesh | NDArray[np.float64],
    protocol: str,
    *,
    scan: NDArray[np.float64] | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> ProtocolResult:
    """Compare by one of `PROTOCOLS`.

    Args:
        mesh: the reconstruction, in the frame of the reference.
        reference: ground truth mesh, or its points (n, 3) for capudf-srb, whose truth is a scan.
        scan: the input points (n, 3); capudf-3dscene crops the prediction to them.
        samples: points per surface; None takes the protocol's own number.
        seed: start of the random numbers.

    Raises:
        ValueError: unknown protocol, or the scan is missing where it is needed.
        EmptySurface: there is nothing to measure.
    """
    generator = np.random.default_rng(seed)
    if protocol == "capudf-cars":
        return _cars(mesh, reference, samples or 100_000, generator)
    if protocol == "capudf-srb":
        return _srb(mesh, reference, samples or 150_000, generator)
    if protocol == "capudf-3dscene":
        return _scene(mesh, reference, scan, samples or 1_000_000, generator)
    raise ValueError(f'unknown protocol "{protocol}"; choose one of: {", ".join(PROTOCOLS)}')


def _cars(
    mesh: Mesh, reference: Mesh | NDArray[np.float64], count: int, generator: np.random.Generator
) -> ProtocolResult:
    pair = agreement(sample(mesh, count, generator), _truth(reference, count, generator))
    figures = {
        "chamfer-L2 x 1e4": 1e4 * pair.chamfer_l2,
        "f-score 0.005": pair.f_score(0.005),
        "f-score 0.01": pair.f_score(0.01),
    } | _normals(reference, pair)
    return ProtocolResult("capudf-cars", figures, "in the units of the reference, not normalised")


def _srb(
    mesh: Mesh, reference: Mesh | NDArray[np.float64], count: int, generator: np.random.Generator
) -> ProtocolResult:
    """The prediction gets a third of the samples: the evaluator asks 150 000 and 50 000."""
    truth = _truth(reference, count, generator)
    scale = float(np.abs(truth.points - truth.points.mean(axis=0)).max())
    found = sample(mesh, max(1, count // 3), generator)
    pair = agreement(
        Samples(found.points / scale, found.normals), Samples(truth.points / scale, truth.normals)
    )
    figures = {"chamfer-L1 x 10": 10 * pair.chamfer_l1, "f-score 0.01": pair.f_score(0.01)}
    note = f"divided by {scale:.6g}, the largest offset from the mean: about twice our scale"
    return ProtocolResult("capudf-srb", figures | _normals(reference, pair), note)


def _scene(
    mesh: Mesh,
    reference: Mesh | NDArray[np.float64],
    scan: NDArray[np.float64] | None,
    count: int,
    generator: np.random.Generator,
) -> ProtocolResult:
    if scan is None:
        raise ValueError("capudf-3dscene crops the mesh to the input scan; give the scan as well")
    cropped = _cropped(mesh, scan)
    truth = _truth(reference, count, generator)
    pair = agreement(sample(cropped, count, generator), truth, per_component=True)
    figures = {"chamfer-L2 x 1e3": 1e3 * pair.chamfer_l2, "chamfer-L1": pair.chamfer_l1}
    note = (
        f"in the units of the reference; cropped to {SCENE_CROP} of the scan's extent; its normal "
        "consistency sums |n_i n'_i| per component, which is never smaller than |n . n'|"
    )
    return ProtocolResult("capudf-3dscene", figures | _normals(reference, pair), note)


def _truth(
    reference: Mesh | NDArray[np.float64], count: int, generator: np.random.Generator
) -> Samples:
    """A sample of a mesh, or `count` of the given points, which have no normals."""
    if isinstance(reference, Mesh):
        bounds(reference)
        return sample(reference, count, generator)
    points = generator.permutation(reference)[:count]
    if len(points) == 0:
        raise EmptySurface("the reference has no points, so there is nothing to measure")
    return Samples(points, np.zeros_like(points))


def _normals(reference: Mesh | NDArray[np.float64], pair: Agreement) -> dict[str, float]:
    if isinstance(reference, Mesh):
        return {"normal consistency": pair.normal_consistency}
    return {}


def _cropped(mesh: Mesh, scan: NDArray[np.float64]) -> Mesh:
    """Faces with all three corners within SCENE_CROP of a scan point."""
    extent = float((scan.max(axis=0) - scan.min(axis=0)).max())
    distance, _ = cKDTree(scan).query(mesh.vertices, workers=-1)
    near = np.asarray(distance < SCENE_CROP * extent)[mesh.faces].all(axis=1)
    if not near.any():
        raise EmptySurface(
            f"no face of the mesh lies within {SCENE_CROP} of the scan's extent; "
            "are mesh and scan in the same frame?"
        )
    return Mesh(mesh.vertices, mesh.faces[near])
