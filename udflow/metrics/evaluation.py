"""A mesh against a reference, honestly: every sampled measure beside its floor."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.metrics.distances import MeshDistance
from udflow.metrics.sampled import Agreement, agreement
from udflow.metrics.surface import Samples, bounds, prepare, sample
from udflow.metrics.topology import Topology, spurious_boundary_edges, topology


@dataclass(frozen=True)
class Measure:
    """A sampled measure beside its floor: what another sample of the reference itself scores.

    Attributes:
        value, value_sd: mean and standard deviation over reseeded samples of the mesh.
        floor, floor_sd: the same over reseeded samples of the reference.
        excess: value - floor, never clipped: a perfect mesh lies on both sides of its floor.
    """

    value: float
    value_sd: float
    floor: float
    floor_sd: float
    excess: float


@dataclass(frozen=True)
class Distances:
    """Exact distances from samples of one surface to the other surface, in 1e-3 of the
    reference's largest extent. No sampling floor."""

    mean: float
    p95: float
    p99: float
    maximum: float


@dataclass(frozen=True)
class Evaluation:
    """A mesh against a reference, both moved by the transform that centres the reference and
    gives it largest extent 1.

    Attributes:
        samples, seeds, seed: points per sample, repetitions, start of the random numbers.
        extent: largest extent of the reference in its own units.
        chamfer: L1 Chamfer distance, half the sum of both means, in 1e-3.
        f_score_010, f_score_005: F-score at 0.01 and 0.005, 0..1.
        normal_consistency: mean |n . n'|, 0..1.
        accuracy: exact distances from the mesh to the reference.
        completeness: exact distances from the reference to the mesh.
        topology, reference_topology: counted after welding, doubled faces dropped.
        spurious_boundary_edges: boundary edges of the mesh farther than 0.02 from every boundary
            of the reference; all of them where the reference is closed.
    """

    samples: int
    seeds: int
    seed: int
    extent: float
    chamfer: Measure
    f_score_010: Measure
    f_score_005: Measure
    normal_consistency: Measure
    accuracy: Distances
    completeness: Distances
    topology: Topology
    reference_topology: Topology
    spurious_boundary_edges: int

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain JSON values."""
        return dataclasses.asdict(self)


def evaluate(
    mesh: Mesh, reference: Mesh, *, samples: int = 100_000, seeds: int = 3, seed: int = 0
) -> Evaluation:
    """Compare a mesh with a reference in the same frame.

    Args:
        mesh: the reconstruction.
        reference: the ground truth; its bounds decide the transform for both.
        samples: points drawn from each surface, at least 100.
        seeds: reseeded samples of mesh and reference, at least 3.
        seed: start of all random numbers.

    Raises:
        EmptySurface: one of the meshes has no surface.
        ValueError: too few samples or seeds.
    """
    if samples < 100:
        raise ValueError(f"samples is {samples}; choose at least 100")
    if seeds < 3:
        raise ValueError(f"seeds is {seeds}; a floor needs at least 3")
    centre, extent = bounds(reference)
    mesh, reference = prepare(mesh, centre, extent), prepare(reference, centre, extent)
    of_mesh = _resampled(mesh, samples, range(1, seeds + 1), seed)
    truth, *again = _resampled(reference, samples, range(seeds + 1, 2 * seeds + 2), seed)
    scores = [agreement(points, truth) for points in of_mesh]
    floors = [agreement(points, truth) for points in again]
    return Evaluation(
        samples=samples,
        seeds=seeds,
        seed=seed,
        extent=extent,
        chamfer=_measure(lambda pair: 1e3 * pair.chamfer_l1, scores, floors),
        f_score_010=_measure(lambda pair: pair.f_score(0.01), scores, floors),
        f_score_005=_measure(lambda pair: pair.f_score(0.005), scores, floors),
        normal_consistency=_measure(lambda pair: pair.normal_consistency, scores, floors),
        accuracy=_summary(MeshDistance(reference)(of_mesh[0].points)),
        completeness=_summary(MeshDistance(mesh)(truth.points)),
        topology=topology(mesh),
        reference_topology=topology(reference),
        spurious_boundary_edges=spurious_boundary_edges(mesh, reference),
    )


def _resampled(mesh: Mesh, count: int, numbers: range, seed: int) -> list[Samples]:
    """Independent samples; mesh and reference never share a stream, or equal meshes would
    score zero in place of the floor."""
    return [sample(mesh, count, np.random.default_rng([seed, number])) for number in numbers]


def _measure(
    score: Callable[[Agreement], float], scores: Sequence[Agreement], floors: Sequence[Agreement]
) -> Measure:
    values, base = np.array([score(p) for p in scores]), np.array([score(p) for p in floors])
    return Measure(
        value=float(values.mean()),
        value_sd=float(values.std(ddof=1)),
        floor=float(base.mean()),
        floor_sd=float(base.std(ddof=1)),
        excess=float(values.mean() - base.mean()),
    )


def _summary(distance: NDArray[np.float64]) -> Distances:
    thousandths = 1e3 * distance
    p95, p99 = np.percentile(thousandths, [95, 99]).tolist()
    return Distances(float(thousandths.mean()), p95, p99, float(thousandths.max()))
