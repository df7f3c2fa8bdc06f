"""`udflow inspect` and `udflow densify`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import RADIUS, off_sphere

from udflow.cli import main
from udflow.cloud.formats import read_cloud


def test_inspect_in_words_and_json(scan: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", scan, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["unique_points"] == 2_000
    assert summary["extent"] == pytest.approx([2 * RADIUS] * 3, rel=0.01)
    assert main(["inspect", scan]) == 0
    assert "points   2000, 2000 distinct" in capsys.readouterr().out


def test_densify_adds_points_on_the_surface(
    scan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "dense.ply"
    options = ["--target", "3000", "--set", "extract.resolution=32", "--quiet", "--json"]
    assert main(["densify", scan, "-o", str(out), *options]) == 0
    assert json.loads(capsys.readouterr().out)["points"]["densified"] == 3_000
    points = read_cloud(out).points
    assert len(points) == 3_000
    assert off_sphere(points).max() < 0.02 * RADIUS
