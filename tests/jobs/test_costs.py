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
