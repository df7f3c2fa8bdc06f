"""No clear loss of accuracy on a few small scans; and the gate does close on one."""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import gate
import numpy as np
import pytest
from common import DATA
from made import MADE
from measuring import figures

LIMITS = gate.gates()["quick"]
SETTINGS = replace(gate.SETTINGS, samples=2_000)


@pytest.mark.parametrize("name", gate.QUICK)
def test_a_small_scan_keeps_its_limits(name: str) -> None:
    row = gate.quick(name, DATA)
    if row is None:
        pytest.skip(f"no {name} under {DATA}")
    assert gate.losses(row, LIMITS[name]) == []


def test_the_truth_itself_keeps_the_limits() -> None:
    truth = MADE["torus"]()
    assert gate.losses(figures(truth, truth, SETTINGS), LIMITS["torus"]) == []


def test_a_displaced_surface_is_a_loss() -> None:
    truth = MADE["torus"]()
    larger = replace(truth, vertices=1.01 * truth.vertices)
    found = gate.losses(figures(larger, truth, SETTINGS), LIMITS["torus"])
    assert [line.split()[0] for line in found] == ["error", "excess"]


def test_a_hole_is_a_loss() -> None:
    truth = MADE["torus"]()
    found = gate.losses(figures(replace(truth, faces=truth.faces[2:]), truth, SETTINGS),
                        LIMITS["torus"])  # fmt: skip
    assert {"loops", "euler", "spurious", "leaky"} <= {line.split()[0] for line in found}


def test_a_second_piece_is_a_loss() -> None:
    truth = MADE["torus"]()
    count = len(truth.vertices)
    dust = np.array([[0.0, 0.0, 0.0], [0.001, 0.0, 0.0], [0.0, 0.001, 0.0]])
    faces = np.concatenate([truth.faces, [[count, count + 1, count + 2]]])
    mesh = replace(truth, vertices=np.concatenate([truth.vertices, dust]), faces=faces)
    found = gate.losses(figures(mesh, truth, SETTINGS), LIMITS["torus"])
    assert any(line.startswith("parts") for line in found)


def test_no_mesh_is_a_loss() -> None:
    assert gate.losses({"failed": "no surface"}, LIMITS["torus"]) == ["no mesh: no surface"]


def test_limits_are_kept_by_what_they_were_made_from() -> None:
    truth = MADE["torus"]()
    row = figures(replace(truth, vertices=1.01 * truth.vertices), truth, SETTINGS)
    allowed = gate.limits(row, SETTINGS.samples)
    assert gate.losses(row, allowed) == []
    assert gate.losses(row | {"error": 1.3 * row["error"]}, allowed) != []


def test_what_is_written_is_read_again() -> None:
    kinds = {"bench": {"cad/wingnut noise-0.3": {"error": 0.125, "loops": 3.0}}}
    assert tomllib.loads(gate.as_toml(kinds)) == kinds


def test_rows_of_the_bench_are_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = MADE["torus"]()
    row = figures(truth, truth, SETTINGS) | {"method": "udflow", "shape": "a", "condition": "clean"}
    file = tmp_path / "bench.json"
    monkeypatch.setattr(gate, "GATES", tmp_path / "gates.toml")
    gate.GATES.write_text("")
    assert run(file, row, "--write") == 0
    assert run(file, row) == 0
    assert run(file, row | {"error": 1.0}) == 1


def run(file: Path, row: dict[str, Any], *options: str) -> int:
    """The gate's exit status for one row of a bench."""
    file.write_text(json.dumps({"settings": {"samples": 2_000}, "rows": [row]}))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "argv", ["gate.py", "--results", str(file), *options])
        try:
            gate.main()
        except SystemExit as end:
            return int(end.code or 0)
    return 0
