"""What a job will take: seconds and memory, from a model that learns on the machine.

The model is linear in the area that is fitted and extracted, in cells, and for trained fields in
the products of matrices, with coefficients from a reference machine (`python -m worker.calibrate`
measures another one). Each finished job leaves how
far the model was off; the median of what the last jobs left corrects the next estimate, and their
spread is its error.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import redis

from jobs import keys

_MB = 1 << 20
_CELLS_PER_SPACING = 1.0  # finest cells of a fit along one spacing of the scan, about
_FEWEST = 3  # finished jobs, below which the reference is taken as it is
_USED = 30  # finished jobs that count
_UNKNOWN = 4.0  # the error factor of the reference on another machine
_LEAST = 1.25  # no estimate claims to be better than this


@dataclass(frozen=True)
class Workload:
    """What decides the cost of a job.

    preset: name; kind: "reconstruct" or "extract"; cells: of the finest fit, along the largest
    extent; points: of the scan; rounds: of densification; steps: of the flow; resolution: of the
    extraction. Of fields that are trained, 0 for others: weights: of the network's matrices,
    neurons: in all layers, batch and iterations: of the training; added: points of densification.
    """

    preset: str
    kind: str
    cells: float
    points: int
    rounds: int
    steps: int
    resolution: int
    weights: int = 0
    neurons: int = 0
    batch: int = 0
    iterations: int = 0
    added: int = 0

    @classmethod
    def of(cls, scan: Mapping[str, Any], config: Mapping[str, Any], kind: str) -> Workload:
        """From a scan's manifest and a complete configuration."""
        points = int(scan.get("unique_points") or 1)
        resolution = int(config["extract"]["resolution"])
        densify = config["densify"]
        missing = max(0, densify["target_points"] - points)
        return cls(
            preset=str(config["preset"]),
            kind=kind,
            cells=_cells(scan, config, resolution),
            points=points,
            rounds=math.ceil(missing / densify["points_per_round"]),
            steps=int(config["flow"]["steps"]),
            resolution=resolution,
            added=missing,
            **_network(config),
        )

    @property
    def is_trained(self) -> bool:
        """Whether the field is a network."""
        return self.weights > 0

    def seconds(self) -> float:
        """On the reference machine: two cores of a shared x86-64 server, of which training uses
        one."""
        extraction = 0.6 + (8.5e-5 + 1.1e-8 * self.weights) * self.resolution**2
        if self.kind == "extract":
            return extraction
        if self.is_trained:
            step = 0.02 + 9.7e-11 * self.weights * self.batch
            asked = 3e-9 * self.weights * self.added
            return 1.5 + self.iterations * step + asked + extraction + 1e-5 * self.points
        fit = (1.2 + 2.7e-4 * self.cells**2) * (0.3 + 0.14 * self.steps)
        return (1 + self.rounds) * fit + extraction + 1e-5 * self.points

    def memory(self) -> float:
        """Bytes of a CPU process at its peak, with everything it has loaded."""
        fit = 60.0 + 8.5e-3 * self.cells**2 if self.kind != "extract" else 0.0
        extraction = 85.0 + 2.2e-3 * self.resolution**2
        if self.is_trained:
            layers = 4 * self.neurons * self.batch / _MB  # what one pass leaves in them
            network = 170.0 + 2.2 * layers + 7e-3 * self.resolution**2
            return (265.0 + 6e-4 * self.points + network) * _MB
        return (265.0 + 6e-4 * self.points + max(fit, extraction)) * _MB


def _network(config: Mapping[str, Any]) -> dict[str, int]:
    """What training costs depend on; nothing where the field is solved for."""
    if config.get("field", "spline") == "spline":
        return {}
    network, training = config["network"], config["training"]
    layers, width = int(network["layers"]), int(network["width"])
    return {
        "weights": layers * width**2,
        "neurons": layers * width,
        "batch": int(training["batch"]),
        "iterations": int(training["iterations"]),
    }


def _cells(scan: Mapping[str, Any], config: Mapping[str, Any], resolution: int) -> float:
    given = config.get("spline", {}).get("resolution")
    if given is not None:
        return float(given)
    extent, spacing = max(scan.get("extent") or [1.0]), scan.get("spacing") or 0.0
    fine = _CELLS_PER_SPACING * extent / spacing if spacing > 0 else resolution
    return min(float(resolution), fine)


@dataclass(frozen=True)
class Sample:
    """What a finished job took. machine_memory: bytes that a job may use where it ran."""

    workload: Workload
    device: str
    seconds: float
    memory: float
    machine_memory: float


@dataclass(frozen=True)
class Range:
    """expected, and between which bounds nine of ten jobs like it lie."""

    expected: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """seconds of work and bytes of memory; jobs: how many finished jobs of the same preset and
    kind on this installation the estimate learned from, 0 if it is the reference's."""

    seconds: Range
    memory_bytes: Range
    jobs: int


class Costs:
    """The last finished jobs, kept in Redis. connection: with text answers."""

    def __init__(self, connection: redis.Redis) -> None:
        self._redis: Any = connection

    def remember(self, sample: Sample) -> None:
        """A job has finished."""
        key = keys.costs(sample.workload.preset, sample.workload.kind)
        with self._redis.pipeline() as pipe:
            pipe.lpush(key, json.dumps(asdict(sample)))
            pipe.ltrim(key, 0, _USED - 1)
            pipe.execute()

    def count(self, stages: Mapping[str, float], points: Mapping[str, int]) -> None:
        """Add to the sums that /metrics shows: seconds by stage, points by kind."""
        with self._redis.pipeline() as pipe:
            for stage, seconds in stages.items():
                pipe.hincrbyfloat(keys.COUNTERS, f"seconds:{stage}", round(seconds, 3))
            for kind, number in points.items():
                pipe.hincrby(keys.COUNTERS, f"points:{kind}", number)
            pipe.execute()

    def estimate(self, workload: Workload) -> Estimate:
        """What such a job will take."""
        known = self._known(workload)
        seconds = [sample.seconds / sample.workload.seconds() for sample in known]
        memory = [sample.memory / sample.workload.memory() for sample in known]
        return Estimate(
            _range(workload.seconds(), seconds, _UNKNOWN),
            _range(workload.memory(), memory, math.sqrt(_UNKNOWN)),
            len(known) if len(known) >= _FEWEST else 0,
        )

    def machine_memory(self, workload: Workload) -> float | None:
        """The most that a job like this could use so far; None if none has run."""
        return max((sample.machine_memory for sample in self._known(workload)), default=None)

    def _known(self, workload: Workload) -> list[Sample]:
        found = self._redis.lrange(keys.costs(workload.preset, workload.kind), 0, _USED - 1)
        samples = [sample_of(json.loads(text)) for text in found]
        return [one for one in samples if one.workload.is_trained == workload.is_trained]


def sample_of(values: dict[str, Any]) -> Sample:
    """The inverse of `dataclasses.asdict`."""
    return Sample(**{**values, "workload": Workload(**values["workload"])})


def _range(reference: float, ratios: Sequence[float], unknown: float) -> Range:
    """The reference's figure, corrected by what the model was off."""
    if len(ratios) < _FEWEST:
        return Range(reference, reference / unknown, reference * unknown)
    middle = statistics.median(ratios)
    ordered = sorted(ratios)
    edge = len(ordered) // 10
    low = min(ordered[edge], middle / _LEAST)
    high = max(ordered[-1 - edge], middle * _LEAST)
    return Range(reference * middle, reference * low, reference * high)
