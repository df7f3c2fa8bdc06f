"""Compiled loops: every row once, whatever the number of threads; and a cache that cannot be."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from udflow.compiled import compiled, over_rows


@compiled
def count_visits(start: int, stop: int, visits: np.ndarray) -> None:
    for row in range(start, stop):
        visits[row] += 1


@pytest.mark.parametrize("rows", [0, 1, 1023, 1024, 5000, 100_001])
def test_every_row_is_visited_once(rows: int) -> None:
    visits = np.zeros(rows, np.int64)
    over_rows(count_visits, rows, visits)
    assert (visits == 1).all()


def test_as_many_threads_as_torch_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[tuple[int, int]] = []
    threads: set[int] = set()

    def note(start: int, stop: int) -> None:
        shares.append((start, stop))
        threads.add(threading.get_ident())
        time.sleep(0.02)

    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    over_rows(note, 9000)
    assert len(threads) == 3
    shares.sort()
    assert len(shares) > 3
    assert [start for start, _ in shares] == [0, *(stop for _, stop in shares[:-1])]
    assert shares[-1][1] == 9000


def test_what_goes_wrong_in_another_thread_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    here = threading.get_ident()

    def fail(start: int, stop: int) -> None:
        if threading.get_ident() != here:
            raise ValueError("no")
        time.sleep(0.02)

    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    with pytest.raises(ValueError, match="no"):
        over_rows(fail, 9000)


def test_who_is_busy_elsewhere_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two questions at once: the short one's helper is still at work on the long one."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    go_on, visits = threading.Event(), np.zeros(9000, np.int64)
    long = threading.Thread(target=over_rows, args=(lambda start, stop: go_on.wait(12), 9000))
    long.start()
    try:
        time.sleep(0.1)
        began = time.monotonic()
        over_rows(count_visits, 9000, visits)
        assert time.monotonic() - began < 10
        assert (visits == 1).all()
    finally:
        go_on.set()
        long.join()


def test_a_forked_process_has_threads_of_its_own() -> None:
    script = (
        "import os, signal, torch\n"
        "from udflow.compiled import over_rows\n"
        "torch.get_num_threads = lambda: 2\n"
        "seen = []\n"
        "over_rows(lambda start, stop: seen.append(stop - start), 9000)\n"
        "if os.fork() == 0:\n"
        "    signal.alarm(20)\n"
        "    over_rows(lambda start, stop: seen.append(stop - start), 9000)\n"
        "    os._exit(0 if sum(seen) == 18000 else 1)\n"
        "print(os.wait()[1])\n"
    )
    command = [sys.executable, "-W", "ignore", "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("0\n", "")


def test_without_a_place_for_its_code_it_compiles_anew(tmp_path: Path) -> None:
    folder = tmp_path / "read_only"
    folder.mkdir()
    (folder / "double.py").write_text(
        "from udflow.compiled import compiled\n"
        "@compiled\ndef double(x: float) -> float:\n    return 2 * x\n"
        "print(double(21.0))\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": "/proc/none", "PYTHONPATH": os.getcwd()}
    command = [sys.executable, str(folder / "double.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("42.0\n", "")


def test_what_another_file_says_is_compiled_anew_when_it_changes(tmp_path: Path) -> None:
    """Constants and functions that a loop imports are in its code, which is kept on disk."""
    (tmp_path / "inner.py").write_text(INNER)
    (tmp_path / "outer.py").write_text(OUTER)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}

    def answer() -> str:
        command = [sys.executable, "-B", "-c", "from outer import outer; print(outer(1.0))"]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.strip()

    assert answer() == "5.0"
    (tmp_path / "inner.py").write_text(INNER.replace("LENGTH = 3.0", "LENGTH = 30.0"))
    assert answer() == "32.0"
    (tmp_path / "inner.py").write_text(INNER.replace("2.0 * x", "4.0 * x"))
    assert answer() == "7.0"


INNER = """
from udflow.compiled import compiled

LENGTH = 3.0


@compiled
def doubled(x):
    return 2.0 * x
"""
OUTER = """
from inner import LENGTH, doubled
from udflow.compiled import compiled


@compiled
def outer(x):
    return doubled(x) + LENGTH
"""
