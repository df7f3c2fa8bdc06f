"""Loops compiled to machine code, where tensors would take hundreds of small steps.

Only what runs on the CPU is compiled; the tensor code beside each loop serves other devices and is
what the tests hold the loop against.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from operator import itemgetter
from typing import Any, TypeVar, cast

import numba
import torch
from numba.core.dispatcher import Dispatcher

Array = Any  # a NumPy array inside a compiled loop
F = TypeVar("F", bound=Callable[..., Any])
_LEAST_ROWS = 1 << 10  # worth a thread
_PIECES = 4  # for each thread


def compiled(function: F) -> F:
    """The function as machine code that runs beside other threads.

    The code is kept on disk for later processes, beside the source or, where that is read-only,
    in the user's cache folder; where neither can be written it is compiled in every process.
    """
    try:
        result = numba.njit(function, nogil=True, error_model="numpy", cache=True)
    except RuntimeError:  # no place for a cache
        return cast(F, numba.njit(function, nogil=True, error_model="numpy"))
    # Numba compiles anew when the file of a function changes. But its code holds what the file
    # imports as well, and of that numba knows nothing.
    kept = result._cache._cache_file
    kept._source_stamp = _STAMPS[result] = (kept._source_stamp, _imported(function.__globals__))
    return cast(F, result)


_STAMPS: dict[object, object] = {}  # of each compiled function


def _imported(names: dict[str, Any]) -> tuple[object, ...]:
    """The constants and compiled functions among the names of a file, these by their stamps."""
    constants = [
        (name, value)
        for name, value in names.items()
        if isinstance(value, bool | int | float | tuple) and not name.startswith("__")
    ]
    functions = [
        (name, _STAMPS[value])
        for name, value in names.items()
        if isinstance(value, Dispatcher) and value in _STAMPS
    ]
    return (*sorted(constants), *sorted(functions, key=itemgetter(0)))


def over_rows(
    loop: Callable[..., None], rows: int, *arguments: Any, least: int = _LEAST_ROWS
) -> None:
    """Runs `loop(start, stop, *arguments)` for all rows, shared among torch's number of threads.

    Rows differ in what they cost, so there are more pieces than threads: who is done takes another.

    Args:
        loop: compiled; writes only what belongs to rows start..stop.
        rows: how many.
        arguments: arrays and numbers that all threads see.
        least: rows that are worth a thread.
    """
    threads = max(1, min(torch.get_num_threads(), rows // least))
    count = min(threads * (_PIECES if threads > 1 else 1), max(rows // least, 1))
    pieces = [(rows * i // count, rows * (i + 1) // count) for i in reversed(range(count))]
    others = [
        _helpers(threads - 1).submit(_take, loop, pieces, arguments) for _ in range(threads - 1)
    ]
    _take(loop, pieces, arguments)
    for other in others:
        if not other.cancel():  # a helper that is busy elsewhere has nothing left to do here
            other.result()


def _take(
    loop: Callable[..., None], pieces: list[tuple[int, int]], arguments: tuple[Any, ...]
) -> None:
    """Runs piece after piece until none is left."""
    while True:
        try:
            start, stop = pieces.pop()  # no other thread gets the same one
        except IndexError:
            return
        loop(start, stop, *arguments)


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    """Threads that wait for work: starting one takes as long as a few thousand rows."""
    return ThreadPoolExecutor(count, thread_name_prefix="rows")


# threads do not survive a fork: the child starts its own
os.register_at_fork(after_in_child=_helpers.cache_clear)
