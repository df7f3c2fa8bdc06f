"""Fitted fields in memory, for distance queries inside the API process."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:  # brings torch, which is loaded with the first query
    from udflow.fields.unsigned import UnsignedDistanceField

T = TypeVar("T")
KEPT = 8
THREADS = 2


class FieldCache:
    """The fields used last, and the few threads that ask them.

    Queries have threads of their own: however many come, the rest of the API answers. Long ones
    are computed in chunks, so that a short one waits for a chunk and not for all of it.
    """

    def __init__(self) -> None:
        self._fields: OrderedDict[Path, asyncio.Task[UnsignedDistanceField]] = OrderedDict()
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="udf")

    async def get(self, path: Path) -> UnsignedDistanceField:
        """The field stored at `path`, read once while it stays among the last used.

        Raises:
            BadField: the file is damaged.
        """
        if path not in self._fields:
            self._fields[path] = asyncio.create_task(self.run(lambda: _load(path)))
            while len(self._fields) > KEPT:
                self._fields.popitem(last=False)
        self._fields.move_to_end(path)
        loading = self._fields[path]
        try:
            # shielded: others may wait for the same field when this caller goes away
            return await asyncio.shield(loading)
        except Exception:
            self._fields.pop(path, None)
            raise

    async def run(self, work: Callable[[], T]) -> T:
        """Runs `work` in one of the query threads."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)

    def close(self) -> None:
        """Ends the threads after what they are doing."""
        self._threads.shutdown(wait=False, cancel_futures=True)


def _load(path: Path) -> UnsignedDistanceField:
    from udflow.fields.storage import load_field

    return load_field(path)
