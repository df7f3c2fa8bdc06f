"""Uploads are read by a confined child process; this is the parent's side."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import sys
from pathlib import Path
from typing import Any

from service.problems import Problem
from service.settings import ServiceSettings

ROOT = Path(__file__).resolve().parents[1]  # `python -m` looks for modules here
log = logging.getLogger("service")


class Inspector:
    """Runs at most `children` readers at a time."""

    def __init__(self, settings: ServiceSettings, children: int = 2) -> None:
        self._settings = settings
        self._slots = asyncio.Semaphore(children)

    async def inspect(self, path: Path) -> dict[str, Any]:
        """The summary of the cloud in this file, as JSON values.

        Raises:
            Problem: 415 or 422 with the reason in words.
        """
        async with self._slots:
            output, status = await self._run(path)
        if status != 0:
            log.warning("reader of %s ended with %s", path.name, status)
            raise Problem(
                "scan_too_costly",
                "Reading the scan took more memory or time than is allowed "
                f"({self._settings.inspect_memory_bytes >> 20} MB, "
                f"{self._settings.inspect_seconds} s), or the reader failed on it. "
                "Send fewer points, or another format.",
            )
        result = json.loads(output)
        if "summary" in result:
            summary: dict[str, Any] = result["summary"]
            return summary
        raise Problem(result["code"], result["detail"])

    async def _run(self, path: Path) -> tuple[bytes, int | str]:
        settings = self._settings
        child = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "service.inspect_child", os.fspath(path)),
            *(str(settings.inspect_memory_bytes), str(settings.inspect_seconds)),
            env=_quiet_environment(),
            cwd=ROOT,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(settings.inspect_seconds):
                output, _ = await child.communicate()
                return output, child.returncode or 0
        except TimeoutError:
            return b"", "its time limit"
        finally:
            # also when the client goes away: no reader outlives its request
            if child.returncode is None:
                child.kill()
                await child.wait()


def _quiet_environment() -> dict[str, str]:
    """What a reader needs and no secret: thread pools would eat its address space."""
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH", "LANG") if name in os.environ}
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
