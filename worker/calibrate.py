"""`python -m worker.calibrate`: a few small jobs, measured, so that estimates fit this machine.

Each runs in a process of its own, as jobs do. What real jobs take replaces these figures by and by.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from jobs.costs import Costs, Sample, Workload, sample_of
from jobs.settings import Settings
from udflow.errors import UdflowError
from worker.cost import machine_memory, peak_memory
from worker.horse import choose_device

log = logging.getLogger("calibrate")

_RUNS: tuple[tuple[int, dict[str, Any]], ...] = (
    (2_000, {"extract": {"resolution": 64}, "densify": {"target_points": 0}}),
    (20_000, {"extract": {"resolution": 128}, "densify": {"target_points": 0}}),
    (20_000, {"extract": {"resolution": 256}, "densify": {"target_points": 0}}),
    (5_000, {"extract": {"resolution": 96}, "densify": {"target_points": 20_000}}),
)


def measured(points: int, changes: Mapping[str, Any], device: str | None) -> Sample:
    """What reconstructing a ring takes in this process."""
    from udflow.cloud.inspection import inspect
    from udflow.cloud.point_cloud import PointCloud
    from udflow.config import from_dict, to_dict
    from udflow.reconstruct import reconstruct

    chosen = choose_device(device)
    cloud, config = PointCloud(_ring(points)), from_dict(dict(changes))
    summary = inspect(cloud)
    workload = Workload.of(vars(summary), to_dict(config), "reconstruct")
    began = time.monotonic()
    reconstruct(cloud, config, device=chosen)
    seconds = time.monotonic() - began
    return Sample(workload, chosen, seconds, peak_memory(), machine_memory())


def _ring(points: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Points on a torus, evenly by angle."""
    around, across = np.random.default_rng(0).uniform(0, 2 * np.pi, (2, points))
    radius = 1.0 + 0.4 * np.cos(across)
    return np.stack(
        [radius * np.cos(around), radius * np.sin(around), 0.4 * np.sin(across)], axis=1
    )


def main() -> int:
    """Measures and remembers. The exit code."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        settings = Settings.from_env()
        costs = Costs(settings.connect())
    except UdflowError as error:
        log.error("%s", error)
        return 1
    for points, changes in _RUNS:
        command = [sys.executable, "-m", "worker.calibrate", str(points), json.dumps(changes)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            log.error("a run with %d points failed: exit status %d", points, done.returncode)
            return 1
        sample = sample_of(json.loads(done.stdout))
        costs.remember(sample)
        off = sample.seconds / sample.workload.seconds()
        log.info(
            "%d points, resolution %d: %.1f s, %d MB, %.2f of the reference's time",
            points,
            sample.workload.resolution,
            sample.seconds,
            sample.memory / 2**20,
            off,
        )
    return 0


def _one(points: str, changes: str) -> int:
    device = os.environ.get("UDFLOW_DEVICE") or None
    sys.stdout.write(json.dumps(asdict(measured(int(points), json.loads(changes), device))))
    return 0


if __name__ == "__main__":
    sys.exit(_one(*sys.argv[1:]) if len(sys.argv) == 3 else main())
