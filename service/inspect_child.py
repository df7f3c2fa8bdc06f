"""Reads one upload in a process of its own: `python -m service.inspect_child PATH MEMORY CPU`.

Readers of foreign formats are where a hostile file would strike, so they run with bounded memory
and time, cannot write files, and end with their parent. The verdict is one JSON object on
standard output.
"""

from __future__ import annotations

import json
import resource
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jobs.processes import die_with_parent


def confine(memory_bytes: int, cpu_seconds: int) -> None:
    """Takes from this process what a reader does not need."""
    limits = {
        resource.RLIMIT_AS: memory_bytes,
        resource.RLIMIT_CPU: cpu_seconds,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NOFILE: 64,
    }
    for limit, value in limits.items():
        resource.setrlimit(limit, (value, value))
    die_with_parent()


def verdict(path: Path) -> dict[str, Any]:
    """{"summary": ...} of a cloud that can be reconstructed, else {"code": ..., "detail": ...}."""
    from udflow.cloud.formats import read_cloud
    from udflow.errors import InvalidCloud

    try:
        cloud = read_cloud(path)
        # brings scipy, which a file that cannot be read need not wait for
        from udflow.cloud.inspection import inspect, require_reconstructable

        require_reconstructable(cloud)
        return {"summary": asdict(inspect(cloud))}
    except InvalidCloud as error:
        return {"code": error.code, "detail": str(error)}


def main() -> None:
    """Prints the verdict; memory that runs out is a verdict too."""
    path, memory_bytes, cpu_seconds = sys.argv[1:]
    confine(int(memory_bytes), int(cpu_seconds))
    try:
        result = verdict(Path(path))
    except MemoryError:
        allowed = f"{int(memory_bytes) >> 20} MB"
        detail = f"reading the scan needs more memory than the {allowed} allowed; thin it out first"
        result = {"code": "scan_too_costly", "detail": detail}
    print(json.dumps(result))  # noqa: T201


if __name__ == "__main__":
    main()
