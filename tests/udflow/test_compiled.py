"""Compiled loops: every row once, whatever the number of threads; and a cache that cannot be."""

from __future__ import annotations

import os
import subprocess
import sys
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

    def note(start: int, stop: int) -> None:
        shares.append((start, stop))

    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    over_rows(note, 9000)
    assert sorted(shares) == [(0, 3000), (3000, 6000), (6000, 9000)]


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
