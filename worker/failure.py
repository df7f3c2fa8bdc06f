"""From an exception to what the user is told. The traceback stays in the log."""

from __future__ import annotations

import errno
import logging

import torch

from jobs.spec import JobError
from udflow.errors import UdflowError

log = logging.getLogger("worker")

OUT_OF_MEMORY = JobError(
    "out_of_memory",
    "the machine ran out of memory; choose a smaller extract.resolution, spline.resolution or "
    "densify.target_points, or run it where there is more memory",
)
TIMEOUT = JobError(
    "timeout",
    "the job ran longer than this server allows; choose smaller resolutions, or raise "
    "UDFLOW_JOB_TIMEOUT_S",
)


class TooLong(Exception):
    """The attempt has used up its time."""


def explain(error: Exception) -> JobError:
    """A stable code, and a sentence with cause and remedy."""
    if isinstance(error, UdflowError):
        return JobError(error.code, str(error))
    if _is_out_of_memory(error):
        return OUT_OF_MEMORY
    if isinstance(error, TooLong):
        return TIMEOUT
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return JobError("storage_full", "the server's disk is full; free some space and retry")
    log.error("unexpected error in a job", exc_info=error)
    return JobError(
        "internal", "an unexpected error, which the server's log describes; retrying may not help"
    )


def _is_out_of_memory(error: Exception) -> bool:
    """torch has a type for the GPU; for the CPU it raises a RuntimeError that only its words
    tell from others."""
    if isinstance(error, MemoryError | torch.OutOfMemoryError):
        return True
    return isinstance(error, RuntimeError) and "DefaultCPUAllocator" in str(error)
