"""What a finished job took, so that the next one can be told beforehand."""

from __future__ import annotations

import logging
import os
import resource
import sys
from pathlib import Path

import redis

from jobs.costs import Costs, Sample, Workload
from jobs.spec import JobRecord
from jobs.store import FileStore

log = logging.getLogger("worker")


def remember_cost(job: JobRecord, store: FileStore, seconds: float, costs: Costs) -> None:
    """Keep the time and memory of this process, which has run one job. Never fails the job."""
    try:
        scan = store.read_scan(job.scan_id) or {}
        workload = Workload.of(scan, job.config, job.kind)
        device = job.device or "cpu"
        costs.remember(Sample(workload, device, seconds, peak_memory(), machine_memory()))
    except (redis.RedisError, OSError, LookupError, TypeError, ValueError) as error:
        log.warning("the cost of %s is not remembered: %s", job.id, error)


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
