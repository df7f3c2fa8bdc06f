"""The configuration: presets, limits, and strict reading of plain values."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from udflow.config import (
    MAX_RESOLUTION,
    PRESET_NAMES,
    Config,
    DensifyConfig,
    ExtractConfig,
    FlowConfig,
    SplineConfig,
    from_dict,
    preset,
    presets,
    to_dict,
)
from udflow.errors import InvalidConfig


def test_it_imports_nothing_heavy() -> None:
    code = (
        "import sys, udflow.config; heavy = {'torch', 'numpy', 'scipy'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_preset_survives_json(name: str) -> None:
    config = preset(name)
    assert config.preset == name
    assert from_dict(json.loads(json.dumps(to_dict(config)))) == config
    assert presets()[name] == config


def test_nothing_said_is_the_default() -> None:
    assert from_dict({}) == Config()
    assert Config().preset == "fast"


def test_what_is_said_changes_and_the_rest_stays() -> None:
    config = from_dict({"seed": 7, "extract": {"resolution": 128}, "densify": {"threshold": 0.01}})
    expected = dataclasses.replace(
        Config(),
        seed=7,
        extract=dataclasses.replace(Config().extract, resolution=128),
        densify=dataclasses.replace(Config().densify, threshold=0.01),
    )
    assert config == expected


def test_figures_taken_from_the_paper() -> None:
    """K = 5 steps; densification keeps f < 0.005 and stops at 30 000 points."""
    config = Config()
    assert config.flow.steps == 5
    assert (config.densify.target_points, config.densify.threshold) == (30_000, 0.005)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"colour": 1}, 'unknown parameter "colour"; known here: densify, extract'),
        ({"extract": {"size": 1}}, 'unknown parameter "extract.size"'),
        ({"preset": "finest"}, 'unknown preset "finest"; choose one of: '),
        ({"preset": 3}, "preset must be a string"),
        ({"preset": None}, "preset must be a string"),
        ({"extract": 256}, "extract must be an object"),
        ({"extract": [256]}, "extract must be an object"),
        ({"seed": "7"}, "seed must be a whole number, not '7'"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"seed": True}, "seed must be a whole number"),
        ({"seed": None}, "seed must not be null"),
        ({"seed": -1}, "choose 0 to 2^63 - 1"),
        ({"densify": {"threshold": "small"}}, "densify.threshold must be a number"),
        ({"densify": {"threshold": True}}, "densify.threshold must be a number"),
        ({"extract": {"extractor": "magic"}}, 'choose "edges" or "cap"'),
        ({"field": "grid"}, 'unknown field "grid"; choose one of: spline, mlp, cap-udf'),
        ({"outliers": "some"}, 'outliers is "some"; choose one of: drop, keep'),
        ({"densify": {"guard": "all"}}, 'choose "support" or "none"'),
        ({"network": {"skips": 4}}, "network.skips must be a list of whole numbers, not 4"),
        ({"network": {"film": [0, 1.5]}}, "network.film must be a list of whole numbers"),
        ({"extract": {"extractor": 1}}, "extract.extractor must be a string"),
    ],
)
def test_wrong_values_are_refused_in_words(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidConfig) as caught:
        from_dict(values)
    assert words in str(caught.value)


LIMITS: list[tuple[type, str, list[Any], list[Any]]] = [
    (FlowConfig, "steps", [1, 100], [0, 101, -5]),
    (SplineConfig, "resolution", [8, 512, None], [7, 513]),
    (SplineConfig, "smoothness", [1e-9, 1e3, None], [0.0, -1.0, 1001.0, math.inf, math.nan]),
    (DensifyConfig, "target_points", [0, 5_000_000], [-1, 5_000_001]),
    (DensifyConfig, "points_per_round", [100, 1_000_000], [0, 99, 1_000_001]),
    (DensifyConfig, "threshold", [1e-9, 0.1, None], [0.0, -0.005, 0.11, math.inf, math.nan]),
    (ExtractConfig, "resolution", [16, MAX_RESOLUTION], [15, MAX_RESOLUTION + 1, 100_000]),
    (Config, "seed", [0, 2**63 - 1], [-1, 2**63]),
]


def fields_of(kind: type) -> Iterator[str]:
    for field in dataclasses.fields(kind):
        if not dataclasses.is_dataclass(getattr(kind(), field.name)):
            yield field.name


def test_every_number_has_its_limits_tested() -> None:
    words = {
        (Config, "preset"),
        (Config, "field"),
        (Config, "outliers"),
        (DensifyConfig, "guard"),
        (ExtractConfig, "extractor"),
    }
    kinds = (Config, FlowConfig, SplineConfig, DensifyConfig, ExtractConfig)
    every = {(kind, name) for kind in kinds for name in fields_of(kind)}
    assert every - words == {(kind, name) for kind, name, _, _ in LIMITS}


@pytest.mark.parametrize(("kind", "name", "good", "bad"), LIMITS)
def test_limits_are_kept_and_named(kind: type, name: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        assert getattr(kind(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(InvalidConfig, match="choose") as caught:
            kind(**{name: value})
        assert name in str(caught.value)


def test_a_whole_number_serves_where_a_real_one_is_wanted() -> None:
    found = from_dict({"spline": {"smoothness": 1}}).spline.smoothness
    assert found == 1.0
    assert isinstance(found, float)


def test_it_cannot_be_changed_afterwards() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().extract.resolution = 10  # type: ignore[misc]


ODD = (
    None,
    True,
    0,
    1,
    -1,
    64,
    2**70,
    0.5,
    math.nan,
    math.inf,
    "",
    "fast",
    "cap",
    "\u5c71",
    [],
    [1],
)
KEYS = ("preset", "seed", "resolution", "threshold", "extractor", "steps", "", "x")
VALUES = st.sampled_from(ODD) | st.dictionaries(st.sampled_from(KEYS), st.sampled_from(ODD))


@given(st.dictionaries(st.sampled_from([*to_dict(Config()), "x"]), VALUES))
def test_any_json_object_is_read_or_refused_in_words(values: dict[str, Any]) -> None:
    try:
        config = from_dict(values)
    except InvalidConfig:
        return
    assert from_dict(to_dict(config)) == config


def test_a_request_schema_built_from_it_is_as_strict() -> None:
    adapter = TypeAdapter(Config)
    assert adapter.validate_python({"extract": {"resolution": 64}}).extract.resolution == 64
    with pytest.raises(ValidationError, match="colour"):
        adapter.validate_python({"colour": 1})
    with pytest.raises(ValidationError, match="choose 16 to"):
        adapter.validate_python({"extract": {"resolution": 100_000}})
