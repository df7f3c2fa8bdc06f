"""Readying the forked process that runs one job."""

from __future__ import annotations

import faulthandler
import logging
import os
import sys
from pathlib import Path

import torch

from jobs.processes import die_with_parent

log = logging.getLogger("worker")

_NICE = (
    10  # a fit takes what is left: beside it the API answers in tens of milliseconds, not hundreds
)
_OOM_SCORE = "800"  # when memory runs out the kernel should take the job, not the worker


_ending = False


def end_soon(*_: object) -> None:
    """For SIGTERM: save what there is and end. Only takes note: an exception here could hit
    SciPy's threads."""
    global _ending
    _ending = True


def is_to_end() -> bool:
    """Whether this process was asked to save and end."""
    return _ending


def prepare(parent: int) -> None:
    """First thing after the fork. parent: pid of the worker, whose death ends this process."""
    die_with_parent(parent=parent)
    faulthandler.enable()  # a crash below Python leaves a traceback in the log
    os.nice(_NICE)
    try:
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    except OSError as error:
        log.info("cannot mark the job's process for the kernel: %s", error)
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(available_cores())


def available_cores() -> int:
    """Cores that this process may use: by affinity and by the container's quota."""
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text().split()
    except OSError:
        return cores
    return cores if quota == "max" else max(1, min(cores, int(quota) // int(period)))


def choose_device(wanted: str | None) -> str:
    """What was asked for, else "cuda" where there is one, else "cpu". Never call this in the
    worker's parent process: CUDA does not survive a fork."""
    return wanted or ("cuda" if torch.cuda.is_available() else "cpu")


def owner_name(worker: str | None = None, pid: int | None = None) -> str:
    """Names a job's process, from inside it, or for its worker from outside."""
    return f"{worker or os.environ.get('RQ_WORKER_ID', 'alone')}:{pid or os.getpid()}"


def oom_kills() -> int:
    """How many processes the kernel has killed for memory since it started; 0 if it won't say."""
    try:
        lines = Path("/proc/vmstat").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("oom_kill "))
