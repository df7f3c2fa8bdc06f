"""Uploads are read by a child process that can neither eat the machine nor outlive its request."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
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


def readers() -> list[str]:
    """Process ids of readers that this process has started."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    commands = {pid: Path(f"/proc/{pid}/cmdline") for pid in children}
    return [pid for pid, file in commands.items() if b"inspect_child" in file.read_bytes()]


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    path = tmp_path / "ball"
    path.write_bytes(ball())
    return path


def test_a_good_file_is_summed_up(cloud: Path) -> None:
    assert inspect(cloud)["points"] == 500


def test_too_much_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "big.npy"
    np.save(path, np.random.default_rng(0).uniform(size=(4_000_000, 3)))
    with pytest.raises(Problem, match="memory") as refused:
        inspect(path, inspect_memory_bytes=250 << 20)
    assert refused.value.status == 422


async def stopped_reader() -> None:
    """Freezes the reader, which then takes for ever without using the processor."""
    while not readers():
        await asyncio.sleep(0.01)
    os.kill(int(readers()[0]), signal.SIGSTOP)


def test_too_much_time_is_refused(cloud: Path) -> None:
    async def story() -> None:
        reading = asyncio.create_task(Inspector(ServiceSettings(inspect_seconds=1)).inspect(cloud))
        await stopped_reader()
        await reading

    with pytest.raises(Problem) as refused:
        asyncio.run(story())
    assert refused.value.code == "scan_too_costly"
    assert readers() == []


def test_no_reader_outlives_its_request(cloud: Path) -> None:
    async def story() -> None:
        reading = asyncio.create_task(Inspector(ServiceSettings()).inspect(cloud))
        await stopped_reader()
        reading.cancel()
        await asyncio.wait({reading}, timeout=5)
        assert reading.cancelled()
        assert readers() == []

    asyncio.run(story())


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
