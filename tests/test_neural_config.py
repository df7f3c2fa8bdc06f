"""The parameters of trained fields: limits in words, and the paper's figures."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest

from udflow.cli import main
from udflow.config import from_dict, preset, to_dict
from udflow.errors import InvalidConfig
from udflow.neural_config import NetworkConfig, TrainingConfig

LIMITS: list[tuple[type, str, list[Any], list[Any]]] = [
    (NetworkConfig, "layers", [5, 64], [0, 65]),
    (NetworkConfig, "width", [4, 4096], [3, 4097]),
    (NetworkConfig, "position_frequencies", [0, 64], [-1, 65]),
    (NetworkConfig, "time_frequencies", [0, 64], [-1, 65]),
    (NetworkConfig, "skips", [(), (1, 7)], [(0,), (8,), (2, 2), (-1,)]),
    (NetworkConfig, "film", [(), (0, 7)], [(8,), (0, 0), (-1,)]),
    (NetworkConfig, "film_width", [None, 4, 4096], [3, 4097]),
    (NetworkConfig, "activation", ["relu"], ["tanh", ""]),
    (NetworkConfig, "output", ["abs", "relu", "softplus"], ["sigmoid", ""]),
    (NetworkConfig, "scale", ["learned", "ideal"], ["none"]),
    (NetworkConfig, "start", ["linear", "he", "sphere"], ["zero"]),
    (TrainingConfig, "iterations", [1, 10_000_000], [0, 10_000_001]),
    (TrainingConfig, "batch", [100, 1_000_000], [99, 1_000_001]),
    (TrainingConfig, "optimiser", ["adam", "muon"], ["sgd"]),
    (TrainingConfig, "learning_rate", [1e-9, 1.0], [0.0, -1e-3, 1.1, float("nan")]),
    (TrainingConfig, "warmup", [0, 1_000_000], [-1, 1_000_001]),
    (TrainingConfig, "queries", [1_000, 100_000_000], [999, 100_000_001]),
    (TrainingConfig, "spread", [1e-9, 10.0], [0.0, -0.25, 10.1, float("inf")]),
    (TrainingConfig, "value_weight", [0.0, 1e3], [-1.0, 1001.0, float("nan")]),
    (TrainingConfig, "sided", [0, 1_000_000], [-1, 1_000_001]),
    (TrainingConfig, "far", [0.0, 1.0], [-0.1, 1.1]),
    (TrainingConfig, "targets", ["points", "quadrics"], ["planes"]),
    (TrainingConfig, "pull_loss", ["chamfer", "points"], ["hausdorff"]),
    (TrainingConfig, "precision", ["float32", "tf32", "bfloat16"], ["float16"]),
]


@pytest.mark.parametrize(("kind", "name", "good", "bad"), LIMITS)
def test_limits_are_kept_and_named(kind: type, name: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        assert getattr(kind(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(InvalidConfig, match="choose") as caught:
            kind(**{name: value})
        assert name in str(caught.value)


def test_every_parameter_has_its_limits_tested() -> None:
    every = {
        (kind, f.name) for kind in (NetworkConfig, TrainingConfig) for f in dataclasses.fields(kind)
    }
    assert every == {(kind, name) for kind, name, _, _ in LIMITS}


def test_the_paper_to_the_letter(capsys: pytest.CaptureFixture[str]) -> None:
    """Section IV-A, as `udflow presets --json` prints it."""
    assert main(["presets", "--json"]) == 0
    paper = json.loads(capsys.readouterr().out)["paper"]
    network, training, densify = paper["network"], paper["training"], paper["densify"]
    assert paper["field"] == "mlp"
    assert paper["flow"]["steps"] == 5
    assert (network["layers"], network["width"]) == (12, 256)
    assert (network["position_frequencies"], network["time_frequencies"]) == (5, 16)
    assert (network["skips"], network["film"]) == ([4, 8], [0, 4, 8])
    assert (network["activation"], network["output"], network["scale"]) == (
        "relu",
        "relu",
        "learned",
    )
    assert (training["iterations"], training["optimiser"]) == (60_000, "adam")
    assert (training["learning_rate"], training["warmup"]) == (1e-3, 1_000)
    assert (training["targets"], training["value_weight"]) == ("points", 0.0)
    assert training["sided"] == 0
    assert densify == {
        "target_points": 30_000,
        "points_per_round": 2_000,
        "threshold": 0.005,
        "guard": "none",
    }
    assert paper["extract"] == {"resolution": 256, "extractor": "cap"}


def test_lists_come_back_as_they_were() -> None:
    config = from_dict({"preset": "paper", "network": {"skips": [2, 6], "film": []}})
    assert (config.network.skips, config.network.film) == ((2, 6), ())
    assert config.network.layers == 12
    assert from_dict(json.loads(json.dumps(to_dict(config)))) == config


def test_neural_is_the_same_formulation_in_small() -> None:
    neural, paper = preset("neural"), preset("paper")
    assert neural.field == paper.field == "mlp"
    assert neural.flow == paper.flow
    assert neural.network.width * neural.network.layers < paper.network.width * 12 // 2
