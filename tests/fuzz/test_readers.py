"""Readers under fire: no crash, no hang, no other error than words, and bounded memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import cloud_files
import pytest
from chaos_kit import SOAK, say

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
ENVIRON = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent), str(ROOT)])}
CORPUS = sorted((HERE / "corpus").iterdir())
FORMATS = [*sorted(cloud_files.samples()), "e57"]
SECONDS = float(os.environ.get("FUZZ_SECONDS", "600")) if SOAK else 0.2


def harness(mode: str, seconds: float, folder: Path, *names: str) -> dict[str, Any]:
    """What the child found; its crash fails the test and names the file that did it."""
    done = subprocess.run(
        [sys.executable, str(HERE / "harness.py"), mode, str(seconds), str(folder), *names],
        capture_output=True,
        text=True,
        env=ENVIRON,
        timeout=len(names) * (seconds + 30) + 240,  # on a loaded machine the last round takes long
    )
    left = [str(path) for path in folder.iterdir() if path.is_file()]
    assert done.returncode == 0, f"{done.returncode} by {left}\n{done.stderr[-3000:]}"
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_what_once_crashed_a_reader_is_told_in_words(tmp_path: Path) -> None:
    found = harness("replay", 0, tmp_path, *map(str, CORPUS))
    assert found["examples"] == len(CORPUS) > 0


def test_damaged_files_of_every_format(tmp_path: Path) -> None:
    if not SOAK:
        found = harness("fuzz", SECONDS, tmp_path, *FORMATS)
        assert found["examples"] >= len(FORMATS)
        return

    def one(name: str) -> dict[str, Any]:
        (tmp_path / name).mkdir()
        return harness("fuzz", SECONDS, tmp_path / name, name)

    broken: dict[str, BaseException] = {}  # whatever happens to one, the others have their time
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        formats = {pool.submit(one, name): name for name in FORMATS}
        for done in as_completed(formats):
            name, error = formats[done], done.exception()
            if error is not None:
                broken[name] = error
                continue
            found = done.result()
            say(
                f"{name}: {found['examples']} files in {SECONDS:g} s, {found['sound']} of them "
                f"sound; at most {found['growth'] >> 20} MB and {found['slowest']:.2f} s"
            )
    assert broken == {}


def test_the_harness_notices(tmp_path: Path) -> None:
    """A harness that finds nothing because it looks at nothing would be no proof."""
    program = f"""
import sys
sys.argv = ["harness", "fuzz", "5", {str(tmp_path)!r}, "off"]
import harness
def broken(path):
    raise IndexError("what a reader must never raise")
harness.read_cloud = broken
harness.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRON, timeout=60
    )
    assert done.returncode != 0
    assert "what a reader must never raise" in done.stderr
    assert (tmp_path / "off").exists()


@pytest.mark.parametrize("eater", ["hold = bytearray(79 << 20)", "import time; time.sleep(9)"])
def test_the_harness_measures(eater: str, tmp_path: Path) -> None:
    program = f"""
import sys
sys.argv = ["harness", "fuzz", "1", {str(tmp_path)!r}, "off"]
import harness
harness.LONGEST_S = 1
def greedy(path):
    {eater}
    raise harness.InvalidCloud("a reader that takes more than it should")
harness.read_cloud = greedy
harness.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRON, timeout=60
    )
    assert done.returncode != 0
    assert "AssertionError: took 7" in done.stderr or done.returncode == -14  # SIGALRM
