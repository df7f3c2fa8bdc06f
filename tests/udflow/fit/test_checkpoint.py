"""Reconstructions that stop and go on: bit for bit, or not at all, in words."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file
from shapes import Sphere

from udflow.cloud.point_cloud import PointCloud
from udflow.config import Config, DensifyConfig, ExtractConfig, FlowConfig
from udflow.errors import BadCheckpoint
from udflow.fields.storage import field_to_bytes
from udflow.neural_config import NetworkConfig, TrainingConfig
from udflow.progress import Progress
from udflow.reconstruct import Reconstruction, reconstruct, reconstruct_steps

CONFIG = Config(
    field="mlp",
    network=NetworkConfig(layers=3, width=24, skips=(2,), film=(0,)),
    training=TrainingConfig(iterations=420, batch=300, queries=6_000, warmup=20),
    densify=DensifyConfig(target_points=1_200, points_per_round=400),
    extract=ExtractConfig(resolution=16),
)
CLOUD = PointCloud(Sphere().sample(600).double().numpy())


def stopped_after(count: int, path: Path, config: Config = CONFIG) -> list[Progress]:
    """The first steps of a reconstruction that then stops for good, saved at every step."""
    steps = reconstruct_steps(CLOUD, config, checkpoint=path, checkpoint_s=0.0)
    seen = [next(steps) for _ in range(count)]
    steps.close()
    return seen


def gone_on(
    path: Path, whole: Reconstruction, config: Config = CONFIG
) -> tuple[Reconstruction, list[Progress]]:
    """The rest of one that was stopped, which must end as one that was not."""
    assert path.exists()
    resumed: list[Progress] = []
    result = reconstruct(CLOUD, config, checkpoint=path, on_progress=resumed.append)
    assert field_to_bytes(result.field) == field_to_bytes(whole.field)
    assert np.array_equal(result.points.points, whole.points.points)
    assert np.array_equal(result.mesh.vertices, whole.mesh.vertices)
    assert np.array_equal(result.mesh.faces, whole.mesh.faces)
    return result, resumed


@pytest.fixture(scope="module")
def whole() -> Reconstruction:
    return reconstruct(CLOUD, CONFIG)


# reading, then the first fit reports at 0, 100, 200 and 210 iterations, each of the two rounds
# at 0, 100 and 105: stopped in the first fit, before the first round's and in the second's
@pytest.mark.parametrize("steps", [3, 6, 10])
def test_it_goes_on_bit_for_bit(steps: int, whole: Reconstruction, tmp_path: Path) -> None:
    path = tmp_path / "half.safetensors"
    seen = stopped_after(steps, path)
    result, resumed = gone_on(path, whole)
    assert result.report["densification"] == whole.report["densification"]
    assert resumed[1].round == seen[-1].round
    assert not path.exists()


def test_an_empty_place_starts_anew(whole: Reconstruction, tmp_path: Path) -> None:
    result = reconstruct(CLOUD, CONFIG, checkpoint=tmp_path / "none.safetensors")
    assert field_to_bytes(result.field) == field_to_bytes(whole.field)


SPLINE = replace(CONFIG, field="spline", flow=FlowConfig(steps=2))


@pytest.fixture(scope="module")
def whole_spline() -> Reconstruction:
    return reconstruct(CLOUD, SPLINE)


# reading, 0, 1 and 2 levels, two rounds of densification, then the extraction begins
@pytest.mark.parametrize(
    ("steps", "then"), [(5, ("densifying", 2)), (6, ("extracting", 2)), (7, ("extracting", 2))]
)
def test_solved_fields_go_on_bit_for_bit(
    steps: int, then: tuple[str, int], whole_spline: Reconstruction, tmp_path: Path
) -> None:
    path = tmp_path / "spline.safetensors"
    stopped_after(steps, path, SPLINE)
    result, resumed = gone_on(path, whole_spline, SPLINE)
    assert result.report["loss"] == whole_spline.report["loss"]
    assert (resumed[1].stage, resumed[1].round) == then  # the field is not solved again


def test_a_trained_field_that_is_whole_is_not_trained_again(
    whole: Reconstruction, tmp_path: Path
) -> None:
    path = tmp_path / "whole.safetensors"
    assert stopped_after(12, path)[-1].stage == "extracting"
    result, resumed = gone_on(path, whole)
    assert result.report["loss"] == whole.report["loss"]
    assert [p.step for p in resumed if p.stage == "densifying"] == [0]


def test_a_fit_is_saved_when_somebody_asks(tmp_path: Path) -> None:
    path = tmp_path / "asked.safetensors"
    asked = iter([False, True])
    steps = reconstruct_steps(
        CLOUD, CONFIG, checkpoint=path, checkpoint_s=1e9, checkpoint_now=lambda: next(asked)
    )
    for _ in range(3):
        next(steps)
    assert not path.exists()
    next(steps)
    assert path.exists()
    steps.close()


def test_a_full_disk_costs_the_checkpoint_and_not_the_fit(
    whole: Reconstruction,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path, faults = tmp_path / "half.safetensors", tmp_path / "faults"
    stopped_after(4, path)
    before = path.read_bytes()
    faults.mkdir()
    monkeypatch.setenv("UDFLOW_FAULTS", str(faults))
    for place in ("checkpoint.begun", "checkpoint.written"):
        (faults / place).write_text("ENOSPC")
        stopped_after(4, path)
        assert not (faults / place).exists()
        assert "No space left on device" in caplog.text
        caplog.clear()
    assert path.read_bytes() != before  # later ones were written again
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["faults", "half.safetensors"]
    result = reconstruct(CLOUD, CONFIG, checkpoint=path)
    assert field_to_bytes(result.field) == field_to_bytes(whole.field)


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
def test_a_bit_that_was_flipped_is_noticed(place: float, bit: int) -> None:
    content = bytearray(_stored())
    content[int(place * len(content))] ^= 1 << bit
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flipped")
        path.write_bytes(content)
        with pytest.raises(BadCheckpoint):
            reconstruct(CLOUD, CONFIG, checkpoint=path)


@cache
def _stored() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "half")
        stopped_after(3, path)
        return path.read_bytes()


def test_another_configuration_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "half.safetensors"
    stopped_after(3, path)
    with pytest.raises(BadCheckpoint, match="another cloud or other parameters"):
        reconstruct(CLOUD, replace(CONFIG, seed=1), checkpoint=path)


def test_another_cloud_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "half.safetensors"
    stopped_after(3, path)
    with pytest.raises(BadCheckpoint, match="another cloud"):
        reconstruct(PointCloud(CLOUD.points[:500]), CONFIG, checkpoint=path)


def test_garbage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "garbage"
    path.write_bytes(b"no checkpoint")
    with pytest.raises(BadCheckpoint, match="remove the file to start anew"):
        reconstruct(CLOUD, CONFIG, checkpoint=path)


def test_a_safetensors_file_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other"
    save_file({"x": torch.zeros(3)}, path)
    with pytest.raises(BadCheckpoint, match="no checkpoint of udflow"):
        reconstruct(CLOUD, CONFIG, checkpoint=path)


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    from safetensors import safe_open

    path = tmp_path / "half.safetensors"
    stopped_after(3, path)
    tensors = load_file(path)
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors["mean"][0] = torch.nan
    save_file(tensors, path, metadata)
    with pytest.raises(BadCheckpoint, match="not finite"):
        reconstruct(CLOUD, CONFIG, checkpoint=path)
    del tensors["mean"]
    save_file(tensors, path, metadata)
    with pytest.raises(BadCheckpoint, match="not complete"):
        reconstruct(CLOUD, CONFIG, checkpoint=path)


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "half.safetensors"
    monkeypatch.setattr("udflow.fit.checkpoint.VERSION", 3)  # as a later release would write it
    stopped_after(3, path)
    monkeypatch.undo()
    with pytest.raises(BadCheckpoint, match="it has version 3"):
        reconstruct(CLOUD, CONFIG, checkpoint=path)


def test_a_first_fit_that_is_enough_is_used_as_it_is() -> None:
    said = iter([False, True, True, True, True, True, True])
    steps = reconstruct_steps(CLOUD, CONFIG, enough=lambda: next(said))
    seen: list[Progress] = []
    while True:
        try:
            seen.append(next(steps))
        except StopIteration as done:
            result = done.value
            break
    assert result.report["partial"]
    assert [p.step for p in seen if p.stage == "fitting"] == [0, 100, 200]
    assert result.report["points"]["rounds"] == 0
