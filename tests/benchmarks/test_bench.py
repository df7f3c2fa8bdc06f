"""The benchmark's parts: scans, rows that join, tables that say who is ahead, the chart."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import bench
import chart
import common
import conditions
import methods
import mls
import numpy as np
import pytest
import records
import tables
from made import MADE
from measuring import rounded, seen_error

from udflow.mesh.load import read_mesh
from udflow.mesh.mesh import Mesh
from udflow.metrics.distances import MeshDistance

BOX = MADE["box"]()


def row(method: str, error: float, **other: Any) -> dict[str, Any]:
    """A row as `measured` makes it."""
    counts = {"boundary_edges": 0, "boundary_loops": 0, "nonmanifold_edges": 0, "components": 1}
    counts |= {"euler_number": 2, "watertight": True}
    distances = {"mean": error, "p95": 2 * error, "p99": 3 * error, "maximum": 4 * error}
    found = {
        "shape": "closed/bunny_hr", "condition": "clean", "method": method, "seconds": 2.0,
        "processor_s": 3.0, "peak_mb": 500, "error": error, "accuracy": distances,
        "completeness": distances, "excess": 0.01, "normals": {"value": 0.99, "floor": 0.995},
        "f_score": {"value": 0.9, "floor": 0.91}, "topology": counts, "true_topology": counts,
        "spurious": 0, "sitting": "one", "origin": "abc, 2026",
    }  # fmt: skip
    return found | other


@pytest.mark.parametrize(
    ("name", "points"), [("clean", 30_000), ("points-3000", 3_000), ("uneven", 30_000)]
)
def test_scans_have_their_points_and_follow_the_seed(name: str, points: int) -> None:
    scan = conditions.CONDITIONS[name].scan
    assert scan(BOX, 0).shape == (points, 3)
    np.testing.assert_array_equal(scan(BOX, 0), scan(BOX, 0))
    assert not np.array_equal(scan(BOX, 0), scan(BOX, 1))


def test_noise_is_measured_in_extents() -> None:
    twice = Mesh(2 * BOX.vertices, BOX.faces)
    scan = conditions.CONDITIONS["noise-0.5"].scan(twice, 0)
    away = MeshDistance(twice)(scan)
    assert away.mean() == pytest.approx(0.01 * (2 / np.pi) ** 0.5, rel=0.05)


def test_one_point_in_twenty_is_astray() -> None:
    away = MeshDistance(BOX)(conditions.CONDITIONS["outliers-5"].scan(BOX, 0))
    assert 0.045 < (away > 1e-9).mean() <= 0.05


def test_density_falls_tenfold() -> None:
    x = conditions.CONDITIONS["uneven"].scan(BOX, 0)[:, 0]
    dense, sparse = ((x > -0.45) & (x < -0.35)).sum(), ((x > 0.35) & (x < 0.45)).sum()
    assert dense / sparse == pytest.approx(10**0.8, rel=0.15)


def test_the_patch_is_empty_and_its_filling_does_not_count() -> None:
    centre, radius = conditions.patch(BOX, 0)
    scan = conditions.CONDITIONS["missing"].scan(BOX, 0)
    assert np.linalg.norm(scan - centre, axis=1).min() > radius
    assert len(scan) < 30_000
    assert seen_error(BOX, BOX, methods.Settings(samples=500)) == pytest.approx(0.0, abs=1e-9)


def test_rows_of_a_later_sitting_replace_and_join(tmp_path: Path) -> None:
    file, settings = tmp_path / "bench.json", methods.Settings()
    order = (["closed/bunny_hr"], list(conditions.CONDITIONS))
    assert records.read(file, settings) == {}
    records.write(file, settings, [row("poisson", 0.3), row("udflow", 0.2)], *order)
    rows = records.read(file, settings) | {records.key(row("udflow", 0.1)): row("udflow", 0.1)}
    written = records.write(file, settings, rows.values(), *order)
    assert [(r["method"], r["error"]) for r in written] == [("udflow", 0.1), ("poisson", 0.3)]
    assert json.loads(file.read_text())["rows"] == written


def test_rows_of_other_settings_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    records.write(file, methods.Settings(), [row("udflow", 0.2)], ["closed/bunny_hr"], ["clean"])
    with pytest.raises(SystemExit, match="same settings"):
        records.read(file, methods.Settings(resolution=128))


def test_the_summary_counts_who_is_ahead() -> None:
    other = {"shape": "cad/wingnut"}
    rows = [row("udflow", 0.1), row("poisson", 0.3), row("udflow", 0.2, **other),
            row("poisson", 0.1, **other, processor_s=1.5)]  # fmt: skip
    ours, peer = tables.summary(rows).splitlines()[2:]
    assert ours.startswith("| clean | udflow | 2 | 1 | 1.00 | 0.010 | 0.50 | 2 | 1.00 | 500 |")
    assert peer.startswith("| clean | poisson | 2 | 1 | 1.75 | 0.010 | 0.50 | 2 | 0.75 | 500 |")


def test_times_of_different_sittings_are_not_compared() -> None:
    rows = [row("udflow", 0.1), row("poisson", 0.3, sitting="another")]
    assert tables.summary(rows).splitlines()[3].endswith("| - | 500 |")


def test_misses_name_the_classic_ahead_and_the_mark() -> None:
    found = tables.misses([row("udflow", 0.2), row("poisson", 0.15), row("mls", 0.1)])
    assert found == [
        "closed/bunny_hr, clean: 0.200, mark 0.18",
        "closed/bunny_hr, clean: 0.200, poisson 0.150",
    ]
    assert tables.misses([row("udflow", 0.1), row("poisson", 0.15)]) == []


def test_a_failed_method_is_behind_and_shown() -> None:
    start = list(row("poisson", 0.1).items())[:6]
    failed = dict(start) | {"sitting": "one", "origin": "abc", "failed": "no normals"}
    rows = [row("udflow", 0.2), failed]
    assert tables.misses(rows) == ["closed/bunny_hr, clean: 0.200, mark 0.18"]
    assert "failed: no normals" in tables.everything(rows)
    assert "**0.200**" in tables.errors(rows)
    assert {len(tables.cells(r)) for r in rows} == {len(tables.HEADER)}


def test_topology_is_right_or_not() -> None:
    good = row("udflow", 0.1)
    assert tables.topology_right(good)
    for change in ({"boundary_loops": 1}, {"nonmanifold_edges": 1}, {"watertight": False}):
        assert not tables.topology_right(good | {"topology": good["topology"] | change})


def test_the_chart_is_svg_with_a_dot_for_each_value() -> None:
    panels = {"clean": {"a": {"udflow": 0.1, "mls": 0.3}, "b": {"udflow": 0.2, "mls": np.inf}}}
    svg = ET.fromstring(chart.dot_chart("errors < 1", panels, ("udflow", "mls"), 2))
    assert len(list(svg.iter("{http://www.w3.org/2000/svg}circle"))) == 3 + 2  # and the legend
    with pytest.raises(ValueError, match="nothing to draw"):
        chart.dot_chart("empty", {"clean": {"a": {"udflow": np.inf}}}, ("udflow",), 1)


def test_without_open3d_the_rest_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    python = sys.executable
    if subprocess.run([python, "-c", "import open3d"], capture_output=True, check=False).returncode:
        assert methods.available(methods.METHODS, python) == ["udflow", "mls"]
        assert "open3d cannot be imported" in capsys.readouterr().err
    assert methods.available(["udflow"], "no such program") == ["udflow"]


def test_peers_are_named_by_option_environment_or_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BENCH_PEERS", raising=False)
    assert methods.peers_python(None) == sys.executable
    monkeypatch.setenv("BENCH_PEERS", "there/python")
    assert methods.peers_python(None) == "there/python"
    assert methods.peers_python("here/python") == "here/python"


def test_moving_least_squares_finds_a_torus(tmp_path: Path) -> None:
    torus = MADE["torus"]()
    scan = conditions.even(1_500)(torus, 0)
    np.save(tmp_path / "scan.npy", scan, allow_pickle=False)
    mls.main(str(tmp_path / "scan.npy"), str(tmp_path / "mesh.ply"), "32")
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert MeshDistance(torus)(mesh.vertices).mean() < 1e-3


def test_a_process_is_measured_from_outside_and_alone() -> None:
    mine = np.ones(30_000_000)  # 240 MB that are not the command's
    done = common.cold([sys.executable, "-c", "import sys; print(1); sys.exit('too few points')"])
    assert (done.code, done.errors) == (1, "too few points\n")
    assert done.processor_s > 0.0
    assert done.seconds > 0.0
    assert 1.0 < done.peak_mb < mine.nbytes / 2**20 / 2


def test_what_takes_too_long_is_ended() -> None:
    assert common.cold([sys.executable, "-c", "import time; time.sleep(60)"], 0.3).code == -9


def test_tables_and_chart_are_written(tmp_path: Path) -> None:
    bench.publish("bench", [row("udflow", 0.2), row("poisson", 0.15)], tmp_path)
    text = (tmp_path / "bench.md").read_text()
    assert "### clean: 30 000 points, evenly by area" in text
    assert "* closed/bunny_hr, clean: 0.200, poisson 0.150" in text
    assert "bunny_hr" in (tmp_path / "bench.svg").read_text()
    assert "| closed/bunny_hr | clean | poisson |" in (tmp_path / "bench_all.md").read_text()
    with pytest.raises(SystemExit, match="no rows yet"):
        bench.publish("bench", [], tmp_path)


def test_figures_keep_five_digits() -> None:
    assert rounded({"a": 0.123456789, "b": {"c": 3, "d": True}}) == {
        "a": 0.12346, "b": {"c": 3, "d": True},
    }  # fmt: skip
