"""Loops compiled to machine code, where tensors would take hundreds of small steps.

Only what runs on the CPU is compiled; the tensor code beside each loop serves other devices and is
what the tests hold the loop against.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import numba
import torch

Array = Any  # a NumPy array inside a compiled loop
F = TypeVar("F", bound=Callable[..., Any])
_LEAST_ROWS = 1 << 10  # worth a thread


def compiled(function: F) -> F:
    """The function as machine code that runs beside other threads.

    The code is kept on disk for later processes, beside the source or, where that is read-only,
    in the user's cache folder; where neither can be written it is compiled in every process.
    """
    try:
        result: F = numba.njit(function, nogil=True, error_model="numpy", cache=True)
    except RuntimeError:  # no place for a cache
        result = numba.njit(function, nogil=True, error_model="numpy")
    return result


def over_rows(
    loop: Callable[..., None], rows: int, *arguments: Any, least: int = _LEAST_ROWS
) -> None:
    """Runs `loop(start, stop, *arguments)` for all rows, shared among torch's number of threads.

    Args:
        loop: compiled; writes only what belongs to rows start..stop.
        rows: how many.
        arguments: arrays and numbers that all threads see.
        least: rows that are worth a thread.
    """
    count = max(1, min(torch.get_num_threads(), rows // least))
    ends = [rows * i // count for i in range(count + 1)]
    others = [
        _helpers(count - 1).submit(loop, ends[i], ends[i + 1], *arguments) for i in range(1, count)
    ]
    loop(ends[0], ends[1], *arguments)
    for other in others:
        other.result()


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    """Threads that wait for work: starting one takes as long as a few thousand rows."""
    return ThreadPoolExecutor(count, thread_name_prefix="rows")


# threads do not survive a fork: the child starts its own
os.register_at_fork(after_in_child=_helpers.cache_clear)
