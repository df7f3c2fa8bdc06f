"""Supervisor, Redis, worker, reaper and API as `make up` starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from api_process import ROOT, free_port, wait_until_up


@contextmanager
def running(data: Path, **more: str) -> Iterator[str]:
    """`service.up`, ready. Ctrl-C must end all of it."""
    folder = data.parent
    port = free_port()
    environment = {
        **{name: value for name, value in os.environ.items() if name != "REDIS_URL"},
        "PORT": str(port),
        "UDFLOW_DATA": str(data),
        "OMP_NUM_THREADS": "1",
        **more,
    }
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.up"],
            cwd=ROOT,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    address = f"http://127.0.0.1:{port}"
    try:
        wait_until_up(address, process, "/readyz", 90)
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(20)
    assert code == 0, (folder / "log").read_text()
