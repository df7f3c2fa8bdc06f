"""Trained fields by the command line: a mesh, a stored field, distances; refusals in words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from shapes import Sphere

from udflow.cli import main
from udflow.errors import BadField
from udflow.fields.cap_udf import CapUdfField
from udflow.fields.mlp import MLPField
from udflow.fields.storage import load_field
from udflow.mesh.load import read_mesh

SMALL = {
    "network.layers": "4",
    "network.width": "32",
    "network.skips": "[2]",
    "network.film": "[0,2]",
    "training.iterations": "400",
    "training.batch": "500",
    "training.learning_rate": "0.005",
    "training.queries": "10000",
    "training.warmup": "20",
    "densify.target_points": "0",
    "extract.resolution": "24",
}


def options(**more: str) -> list[str]:
    values = SMALL | {name.replace("__", "."): value for name, value in more.items()}
    return [part for key, value in values.items() for part in ("--set", f"{key}={value}")]


@pytest.fixture(scope="module", params=["mlp", "cap-udf"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan of a sphere of radius 50, its mesh and its stored field."""
    folder = tmp_path_factory.mktemp(request.param)
    np.save(folder / "scan.npy", 100 * Sphere().sample(2_000).numpy().astype(float))
    files = ["-o", str(folder / "mesh.ply"), "--field", str(folder / "f"), "--quiet"]
    files += ["--report", str(folder / "r.json")]
    command = ["reconstruct", str(folder / "scan.npy"), "--preset", "neural", *files]
    assert main([*command, *options(field=request.param)]) == 0
    return folder


def test_the_mesh_is_the_sphere(made: Path) -> None:
    mesh = read_mesh(made / "mesh.ply")
    off = np.abs(np.linalg.norm(mesh.vertices, axis=1) - 50)
    assert len(mesh.faces) > 500
    assert off.mean() < 1.0
    report = json.loads((made / "r.json").read_text())
    assert report["parameters"] > 1_000
    assert report["flops_per_iteration"] > 1e6
    assert "spline_resolution" not in report


def test_the_stored_field_answers(made: Path, tmp_path: Path) -> None:
    queries = np.array([[60.0, 0, 0], [0, 0, -52], [0, 120, 0], [0, 0, 1_000]])
    np.save(tmp_path / "q.npy", queries)
    command = ["query", str(made / "f"), str(tmp_path / "q.npy"), "-o", str(tmp_path / "d.npy")]
    assert main([*command, "--json"]) == 0
    np.testing.assert_allclose(np.load(tmp_path / "d.npy"), [10, 2, 70, 950], atol=2)


def test_a_stored_field_comes_back_bit_by_bit(made: Path) -> None:
    field = load_field(made / "f").fitted
    assert isinstance(field, MLPField | CapUdfField)
    assert torch.equal(load_file(made / "f")["parameters"], field.parameters)
    assert field.half_edge == 1.5
    assert 0.01 < field.reach < 0.5


def test_damaged_parameters_are_refused(made: Path, tmp_path: Path) -> None:
    from safetensors import safe_open

    tensors = load_file(made / "f")
    with safe_open(made / "f", framework="pt") as file:
        metadata = file.metadata()
    for broken, words in (
        (tensors["parameters"][:-1], "wrong number of parameters"),
        (tensors["parameters"].double(), "wrong number of parameters"),
        (tensors["parameters"] * torch.nan, "not finite"),
    ):
        save_file({**tensors, "parameters": broken.contiguous()}, tmp_path / "b", metadata)
        with pytest.raises(BadField, match=words):
            load_field(tmp_path / "b")
    header = json.loads(metadata["udflow"])
    for change, words in (
        ({"network": header["network"] | {"layers": 0}}, "impossible network"),
        ({"network": header["network"] | {"colour": 1}}, "impossible network"),
        ({"network": header["network"] | {"output": "tanh"}}, "impossible network"),
        ({"network": 3}, "impossible network"),
        ({"reach": -1.0}, "impossible box"),
        ({"half_edge": 1e9}, "impossible box"),
    ):
        changed = {"udflow": json.dumps(header | change)}
        save_file(tensors, tmp_path / "b", changed)
        with pytest.raises(BadField, match=words):
            load_field(tmp_path / "b")


def test_a_checkpoint_is_used_up(made: Path, tmp_path: Path) -> None:
    command = ["reconstruct", str(made / "scan.npy"), "-o", str(tmp_path / "m.ply"), "--quiet"]
    command += ["--preset", "neural", "--checkpoint", str(tmp_path / "c")]
    assert main([*command, *options(training__iterations="100")]) == 0
    assert not (tmp_path / "c").exists()
    (tmp_path / "c").write_bytes(b"?")
    assert main([*command, "--force", *options(training__iterations="100")]) == 3


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("flow.steps=0", "flow.steps is 0; choose 1 to 100"),
        ("densify.threshold=-0.005", "densify.threshold is -0.005; choose a length above 0"),
        ("network.activation=gelu", 'network.activation is "gelu"; choose one of: "relu"'),
        ("network.output=tanh", 'choose one of: "abs", "relu", "softplus"'),
        ("network.skips=[0]", "choose different layers from 1 to 7"),
    ],
)
def test_bad_parameters_are_refused_in_words(
    setting: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["reconstruct", "scan.npy", "-o", "mesh.ply", "--preset", "neural"]
    assert main([*command, "--set", setting]) == 2
    assert words in capsys.readouterr().err


def test_a_target_below_the_scan_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "scan.npy", Sphere().sample(500).numpy())
    scan, setting = str(tmp_path / "scan.npy"), ["--set", "densify.target_points=400"]
    for command in (
        ["densify", scan, "-o", str(tmp_path / "p.ply"), "--target", "400"],
        ["densify", scan, "-o", str(tmp_path / "p.ply"), *setting],
        ["reconstruct", scan, "-o", str(tmp_path / "m.ply"), *setting],
    ):
        assert main(command) == 2
        assert "fewer than the 500 points of the cloud; raise it" in capsys.readouterr().err
