"""docs/reliability.md names tests that exist, for every failure and every threat."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from udflow.faults import PLACES

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "reliability.md").read_text()
ROW = re.compile(r"^\| ([FS]\d+) \|(.*)\|$", re.MULTILINE)
NAME = re.compile(r"\btest_\w+\b(?!\.py)")
FILE = re.compile(r"`((?:udflow|jobs|worker|service|tests|web)/[\w/.]+|constraints\.txt)`")


def test_every_test_that_is_named_exists() -> None:
    known: set[str] = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        tree = ast.parse(path.read_text())
        known |= {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    named = set(NAME.findall(PAGE))
    assert len(named) > 100
    assert named - known == set()


def test_every_failure_and_threat_has_a_test_or_a_reason() -> None:
    rows = {number: row.split("|") for number, row in ROW.findall(PAGE)}
    expected = [f"F{n}" for n in range(1, 29)] + [f"S{n}" for n in range(1, 23)]
    assert list(rows) == expected
    for number, (_, _, shown, left_out) in rows.items():
        assert NAME.search(shown) or len(left_out.strip()) > 20, number


def test_every_file_that_is_named_exists() -> None:
    assert [name for name in FILE.findall(PAGE) if not (ROOT / name).exists()] == []


def test_every_place_for_faults_is_used_once_armed() -> None:
    text = "".join(path.read_text() for path in (ROOT / "tests" / "chaos").glob("test_*.py"))
    assert [place for place in PLACES if f'"{place}"' not in text] == []
    rooms = ("udflow", "jobs", "worker", "service")
    code = "".join(path.read_text() for room in rooms for path in (ROOT / room).rglob("*.py"))
    assert [place for place in PLACES if f'hit("{place}")' not in code] == []
