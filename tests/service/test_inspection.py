"""Uploads are read by a child process that can neither eat the machine nor outlive its request."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from api_process import ROOT, ball

from service.inspection import Inspector
from service.problems import Problem
from service.settings import ServiceSettings


def inspect(path: Path, **limits: int) -> dict[str, object]:
    async def story() -> dict[str, object]:
        return await Inspector(ServiceSettings(**limits)).inspect(path)

    return asyncio.run(story())


@pytest.fixture
def long_text(tmp_path: Path) -> Path:
    """Takes the reader several seconds."""
    path = tmp_path / "long.xyz"
    with path.open("wb") as file:
        for _ in range(60):
            file.write(b"1.25 2.5 3.75\n" * 50_000)
    return path


def readers() -> list[str]:
    """Process ids of readers that this process has started."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    commands = {pid: Path(f"/proc/{pid}/cmdline") for pid in children}
    return [pid for pid, file in commands.items() if b"inspect_child" in file.read_bytes()]


def test_a_good_file_is_summed_up(tmp_path: Path) -> None:
    path = tmp_path / "ball"
    path.write_bytes(ball())
    assert inspect(path)["points"] == 500


def test_too_much_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "big.npy"
    np.save(path, np.random.default_rng(0).uniform(size=(4_000_000, 3)))
    with pytest.raises(Problem, match="memory") as refused:
        inspect(path, inspect_memory_bytes=250 << 20)
    assert refused.value.status == 422


def test_too_much_time_is_refused(long_text: Path) -> None:
    began = time.monotonic()
    with pytest.raises(Problem) as refused:
        inspect(long_text, inspect_seconds=1)
    assert refused.value.code == "scan_too_costly"
    assert time.monotonic() - began < 3
    assert readers() == []


def test_no_reader_outlives_its_request(long_text: Path) -> None:
    async def story() -> int:
        reading = asyncio.create_task(Inspector(ServiceSettings()).inspect(long_text))
        while not readers():
            await asyncio.sleep(0.01)
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
        return len(readers())

    assert asyncio.run(story()) == 0


def test_a_reader_writes_no_files(tmp_path: Path) -> None:
    program = (
        "import signal; from service.inspect_child import confine; confine(1 << 32, 10); "
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        f"open({str(tmp_path / 'made')!r}, 'w', buffering=1).write('text' * 10000)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode != 0
    assert "File too large" in ended.stderr
