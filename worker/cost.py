"""What a finished job took, so that the next one can be told beforehand."""

from __future__ import annotations

import logging
import os
import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import redis

from jobs.costs import Costs, Sample, Workload
from jobs.files import read_json
from jobs.spec import Artifact, JobRecord
from jobs.store import FileStore
from udflow.progress import STAGES

log = logging.getLogger("worker")


def remember_cost(
    job: JobRecord,
    store: FileStore,
    seconds: float,
    costs: Costs,
    outputs: Mapping[str, Artifact],
) -> None:
    """Keep the time and memory of this process, which has run one job. Never fails the job."""
    try:
        scan = store.read_scan(job.scan_id) or {}
        workload = Workload.of(scan, job.config, job.kind)
        device = job.device or "cpu"
        report = _report(outputs, store)
        costs.count(_stages(report), _points(report))
        costs.remember(Sample(workload, device, seconds, peak_memory(), machine_memory()))
    except (redis.RedisError, OSError, LookupError, TypeError, ValueError) as error:
        log.warning("the cost of %s is not remembered: %s", job.id, error)


def _report(outputs: Mapping[str, Artifact], store: FileStore) -> dict[str, Any]:
    artifact = outputs.get("report.json")
    report: dict[str, Any] = (read_json(store.artifact_path(artifact)) if artifact else None) or {}
    return report


def _stages(report: Mapping[str, Any]) -> dict[str, float]:
    seconds = report.get("seconds", {})
    return {stage: float(spent) for stage, spent in seconds.items() if stage in STAGES}


def _points(report: Mapping[str, Any]) -> dict[str, int]:
    points = report.get("points")
    kinds = ("input", "densified")
    return {kind: points[kind] for kind in kinds} if isinstance(points, dict) else {}


def peak_memory() -> float:
    """Bytes this process has used at its peak."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)


def machine_memory() -> float:
    """Bytes that this process may use: the machine's, or less in a container."""
    there = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    try:
        allowed = Path("/sys/fs/cgroup/memory.max").read_text().strip()
    except OSError:
        return there
    return there if allowed == "max" else min(there, float(allowed))
