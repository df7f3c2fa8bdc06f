"""What jobs will take, learned from those that have run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import redis

from jobs.costs import Costs, Sample, Workload
from udflow.config import from_dict, to_dict

SCAN = {"unique_points": 20_000, "extent": (2.0, 1.0, 1.0), "spacing": 0.01}


def workload(kind: str = "reconstruct", **changes: Any) -> Workload:
    return Workload.of(SCAN, to_dict(from_dict(changes)), kind)


@pytest.fixture
def costs(connection: redis.Redis) -> Costs:
    return Costs(connection)


def test_the_scan_and_the_parameters_decide() -> None:
    base = workload()
    assert (base.points, base.resolution, base.rounds, base.cells) == (20_000, 256, 1, 200.0)
    assert workload(extract={"resolution": 64}).cells == 64.0
    assert workload(spline={"resolution": 100}).cells == 100.0
    assert workload(densify={"target_points": 0}).rounds == 0
    finer = workload(extract={"resolution": 512})
    assert finer.seconds() > base.seconds()
    assert finer.memory() > base.memory()
    assert workload("extract").seconds() < base.seconds() / 3


# what jobs with trained fields took on one thread of the reference machine
TRAINED = [
    ("neural", 4000, 48, {"iterations": 200}, 12.4, 457),
    ("neural", 4000, 96, {"iterations": 200}, 23.2, 508),
    ("paper", 3000, 32, {"iterations": 20, "warmup": 5}, 15.1, 566),
    ("paper", 3000, 48, {"iterations": 20, "warmup": 5}, 33.4, 608),
]


@pytest.mark.parametrize(("preset", "points", "resolution", "training", "seconds", "mb"), TRAINED)
def test_trained_fields_have_a_reference_too(
    preset: str, points: int, resolution: int, training: dict[str, int], seconds: float, mb: float
) -> None:
    changes = {
        "preset": preset,
        "extract": {"resolution": resolution},
        "densify": {"target_points": 0},
        "training": training,
    }
    scan = SCAN | {"unique_points": points}
    found = Workload.of(scan, to_dict(from_dict(changes)), "reconstruct")
    assert found.is_trained
    assert found.seconds() == pytest.approx(seconds, rel=0.35)
    assert found.memory() / 2**20 == pytest.approx(mb, rel=0.15)


def test_training_takes_what_its_iterations_take() -> None:
    whole = workload(preset="paper")
    assert whole.seconds() > 5 * 3600
    half = workload(preset="paper", training={"iterations": 30_000})
    assert 0.45 < half.seconds() / whole.seconds() < 0.6
    assert workload("extract", preset="paper").seconds() > 5 * workload("extract").seconds()
    assert workload(preset="neural").seconds() < whole.seconds() / 10


def test_figures_from_before_networks_were_known_teach_nothing_about_them(costs: Costs) -> None:
    trained = workload(preset="neural")
    for _ in range(5):
        costs.remember(Sample(replace(trained, weights=0), "cpu", 1.0, 1e9, 8e9))
    assert costs.estimate(trained).jobs == 0


def test_without_jobs_the_reference_is_told_with_a_wide_range(costs: Costs) -> None:
    estimate = costs.estimate(workload())
    assert estimate.jobs == 0
    assert estimate.seconds.expected == workload().seconds()
    assert estimate.seconds.high / estimate.seconds.low >= 10
    assert costs.machine_memory(workload()) is None


def test_finished_jobs_correct_it(costs: Costs) -> None:
    small = workload(extract={"resolution": 64})
    for share in (0.9, 1.0, 1.1, 1.0, 1.05):
        seconds, memory = 3.0 * share * small.seconds(), 2.0 * small.memory()
        costs.remember(Sample(small, "cpu", seconds, memory, 8e9))
    estimate = costs.estimate(workload())
    assert estimate.jobs == 5
    assert estimate.seconds.expected == pytest.approx(3.0 * workload().seconds(), rel=0.01)
    assert estimate.memory_bytes.expected == pytest.approx(2.0 * workload().memory(), rel=0.01)
    assert estimate.seconds.low < estimate.seconds.expected < estimate.seconds.high
    assert estimate.seconds.high / estimate.seconds.low < 2
    assert costs.machine_memory(workload()) == 8e9


def test_jobs_of_another_kind_teach_nothing(costs: Costs) -> None:
    for _ in range(5):
        costs.remember(Sample(workload("extract"), "cpu", 1e6, 1e12, 8e9))
    assert costs.estimate(workload()).jobs == 0
    assert costs.estimate(replace(workload(), preset="another")).jobs == 0


def test_only_the_last_jobs_count(costs: Costs) -> None:
    for factor in [10.0] * 20 + [1.0] * 40:
        job = workload()
        costs.remember(Sample(job, "cpu", factor * job.seconds(), job.memory(), 8e9))
    estimate = costs.estimate(workload())
    assert estimate.jobs == 30
    assert estimate.seconds.expected == pytest.approx(workload().seconds())
