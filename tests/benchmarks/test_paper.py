"""The paper's experiments: variants are configurations, tables and pictures can be read."""

from __future__ import annotations

import runpy
import struct
import subprocess
import sys
import zlib
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from made import MADE, sponge
from numpy.typing import NDArray

PAPER = Path(__file__).resolve().parents[2] / "benchmarks" / "paper"
sys.path.append(str(PAPER))

import common  # noqa: E402
import conditions  # noqa: E402
import densification_shapes  # noqa: E402
import lab  # noqa: E402

EXPERIMENTS = sorted(
    file.name for kind in ("table6_*", "fig*", "silent*") for file in PAPER.glob(f"{kind}.py")
)
OPTIONS = Namespace(
    preset="neural", seed=0, full=False, budget=1.0, resolution=24, samples=500, device="cpu"
)


@pytest.fixture(params=EXPERIMENTS)
def experiment(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a script hands to the laboratory."""
    found: dict[str, Any] = {}

    def run(name: str, title: str, note: str, variants: list[lab.Variant]) -> None:
        found.update(name=name, title=title, note=note, variants=variants)

    monkeypatch.setattr(lab, "run", run)
    runpy.run_path(str(PAPER / request.param), run_name="__main__")
    return found | {"script": request.param}


@pytest.mark.parametrize("preset", ["neural", "paper"])
def test_every_variant_is_a_configuration(experiment: dict[str, Any], preset: str) -> None:
    names = [variant.name for variant in experiment["variants"]]
    assert len(set(names)) == len(names) >= 3
    options = Namespace(**{**vars(OPTIONS), "preset": preset, "full": preset == "paper"})
    for variant in experiment["variants"]:
        config = lab.configured(variant, options)
        assert config.seed == 0
        assert 1_000 <= variant.points <= 30_000
    distinct = lab.distinct(experiment["variants"], options)
    assert len(names) - 4 <= len(distinct)  # what a preset has already need not run again
    assert len(distinct) >= 3


@pytest.mark.parametrize("script", ["fig14_conditions", "beside_the_surface"])
def test_a_script_starts_by_itself(script: str) -> None:
    command = [sys.executable, str(PAPER / f"{script}.py"), "--help"]
    found = subprocess.run(command, capture_output=True, text=True, check=False, cwd=PAPER.parent)
    assert found.returncode == 0, found.stderr
    assert "--save" in found.stdout


def test_every_script_is_named_in_the_readme_with_its_table(experiment: dict[str, Any]) -> None:
    readme = (PAPER.parent / "README.md").read_text()
    assert f"benchmarks/paper/{experiment['script']}" in readme
    assert experiment["name"] == f"paper_{Path(experiment['script']).stem}"


def pixels(file: Path) -> NDArray[np.uint8]:
    """(height, width, 4) of a PNG of one part without filters."""
    data = file.read_bytes()
    width, height, depth, kind = struct.unpack(">IIBB", data[16:26])
    assert (depth, kind) == (8, 6)
    start = data.index(b"IDAT")
    (length,) = struct.unpack(">I", data[start - 4 : start])
    raw = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + length]), np.uint8)
    rows = raw.reshape(height, 1 + 4 * width)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 4)


def test_a_table_and_a_picture_come_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (common, lab):
        monkeypatch.setattr(module, "RESULTS", tmp_path)
    monkeypatch.setattr(common, "ROOT", tmp_path)
    solved = {"field": "spline", "densify": {"target_points": 0}}
    variant = lab.Variant("solved", solved, points=800)
    row, mesh = lab.measured("made/torus", MADE["torus"](), variant, OPTIONS)
    origin = {**common.provenance(), "settings": {"budget": "none"}}
    lab._publish("t", "Title", "Note.", [row], origin)
    lab.picture_of("t", [mesh, None], 2)
    text = (tmp_path / "t.md").read_text()
    assert "| made/torus | solved | - |" in text
    assert "from left to right: solved" in text
    picture = pixels(tmp_path / "t.png")
    left, right = np.hsplit(picture, 2)
    assert left.min() < 200
    assert right.min() == 255 == picture[..., 3].min()


def test_a_budget_buys_iterations() -> None:
    config = lab.configured(lab.Variant("small", {"network": {"width": 16}}), OPTIONS)
    few, more = (lab.within(config, seconds).training for seconds in (0.001, 200.0))
    assert few.iterations == 100
    assert more.iterations > 600
    assert more.warmup <= more.iterations // 10
    assert few.sided == 0  # too short for such a start
    assert more.sided == config.training.sided
    changes = {"network": {"width": 16, "output": "relu"}, "flow": {"steps": 1}}
    same_cost = lab.configured(lab.Variant("other", changes), OPTIONS)
    assert lab.within(same_cost, 200.0).training.iterations == more.iterations


def test_a_variant_that_changes_nothing_is_left_out() -> None:
    variants = [
        lab.Variant("as it is"),
        lab.Variant("output abs", {"network": {"output": "abs"}}),
        lab.Variant("output relu", {"network": {"output": "relu"}}),
        lab.Variant("few", points=5_000),
    ]
    names = [variant.name for variant in lab.distinct(variants, OPTIONS)]
    assert names == ["as it is", "output relu", "few"]


def test_the_sponge_is_closed_and_of_genus_81() -> None:
    mesh = sponge()
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert made.is_watertight
    assert made.is_winding_consistent
    assert made.euler_number == 2 - 2 * 81
    assert made.volume == pytest.approx((20 / 27) ** 2)


def test_depth_cameras_err_more_the_farther_away_they_are() -> None:
    truth = MADE["torus"]()
    exact = common.scan_of(truth, conditions.FULL, 0.0, 0)
    error = np.linalg.norm(conditions.by_depth_cameras(truth, 0) - exact, axis=1)
    assert 0.5e-3 < np.median(error) < 2e-3
    from_axis = np.hypot(exact[:, 0], exact[:, 1])
    assert error[from_axis > 0.45].mean() < 0.8 * error[from_axis < 0.25].mean()


def test_densification_is_counted_by_what_changes() -> None:
    rows = [
        {"without": {"error": 1.0}, "with": {"error": error}} for error in (0.8, 1.2, 1.001, 0.999)
    ]
    rows.append({"without": {"failed": "no surface"}, "with": {"error": 1.0}})
    assert densification_shapes._count(rows) == (
        "Of 5 shapes 1 get better by more than 1%, 1 worse, 2 stay the same; 1 failed."
    )
