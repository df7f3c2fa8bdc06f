"""Ending tasks for certain."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

_AGAIN_S = 0.1


async def end(*tasks: asyncio.Task[Any]) -> None:
    """Cancel tasks until they are over; raises what they raised.

    Once is not enough: before Python 3.12 `asyncio.wait_for`, inside which redis-py sends, drops a
    cancel that comes in the moment in which it is done, and the task would run for ever.
    """
    while running := [task for task in tasks if not task.done()]:
        for task in running:
            task.cancel()
        await asyncio.wait(running, timeout=_AGAIN_S)
    for task in tasks:
        with suppress(asyncio.CancelledError):
            await task
