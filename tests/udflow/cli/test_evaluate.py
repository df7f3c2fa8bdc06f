"""`udflow evaluate`: a mesh against a reference."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RADIUS

from udflow.cli import main


def test_evaluate_measures_in_the_frame_of_the_reference(
    made: Path, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, few = str(made / "mesh.ply"), ["--samples", "5000"]
    assert main(["evaluate", mesh, "--reference", truth, *few, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["extent"] == pytest.approx(2 * RADIUS, rel=1e-3)
    assert found["accuracy"]["mean"] < 5
    assert found["topology"]["euler_number"] == 2
    assert main(["evaluate", mesh, "--reference", truth, *few]) == 0
    shown = capsys.readouterr().out
    assert f"{found['accuracy']['mean']:.4f}" in shown
    assert "watertight" in shown


def test_evaluate_by_protocol(
    made: Path, truth: str, scan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["evaluate", str(made / "mesh.ply"), "--samples", "3000", "--json", "--reference"]
    assert main([*base, truth, "--protocol", "capudf-cars"]) == 0
    assert "chamfer-L2 x 1e4" in json.loads(capsys.readouterr().out)["figures"]
    assert main([*base, scan, "--protocol", "capudf-srb"]) == 0
    assert json.loads(capsys.readouterr().out)["figures"]["chamfer-L1 x 10"] < 1
    assert main([*base, truth, "--protocol", "capudf-3dscene"]) == 2
    assert "add --scan" in capsys.readouterr().err


def test_evaluate_wants_triangles(
    made: Path, scan: str, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", scan, "--reference", truth]) == 3
    assert "triangles" in capsys.readouterr().err
    assert main(["evaluate", truth, "--reference", truth, "--seeds", "1"]) == 2
    assert "at least 3" in capsys.readouterr().err
