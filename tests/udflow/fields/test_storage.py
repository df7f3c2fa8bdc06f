"""Stored fields: exact when whole, refused in words when not."""

from __future__ import annotations

import json
import math
import pickle
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import load, save
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.errors import BadField
from udflow.fields.storage import field_to_bytes, load_field, save_field
from udflow.fields.unsigned import UnsignedDistanceField

Tensors = dict[str, Tensor]
Header = dict[str, Any]


@pytest.fixture(scope="module")
def stored(sphere_field: UnsignedDistanceField) -> bytes:
    return field_to_bytes(sphere_field)


def header_of(content: bytes) -> Header:
    (length,) = struct.unpack("<Q", content[:8])
    metadata = json.loads(content[8 : 8 + length])["__metadata__"]
    return json.loads(metadata["udflow"])


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_a_field_comes_back_bit_by_bit(sphere_field: UnsignedDistanceField, tmp_path: Path) -> None:
    odd = Normalisation((512345.123456789, 1 / 3, -1e-7), 1e3 / 7)
    field = replace(sphere_field, normalisation=odd)
    path = tmp_path / "field.safetensors"
    save_field(field, path)
    back = load_field(path)
    points = odd.to_world(np.random.default_rng(0).uniform(-1.8, 1.8, (5000, 3)))
    one, two = field.query(points), back.query(points)
    for name in ("distance", "gradient", "closest", "valid"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name
    assert back.normalisation == odd
    assert back.fitted.schedule == field.fitted.schedule
    assert field_to_bytes(back) == path.read_bytes()


def test_it_is_smaller_than_it_could_be(stored: bytes, sphere_field: UnsignedDistanceField) -> None:
    """The 27 gathered coefficients per cell are made again, not stored."""
    rows = sum(level.rows.numel() for level in sphere_field.fitted.levels)
    assert len(stored) < 4 * rows / 3


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no field at .*nothing"):
        load_field(tmp_path / "nothing")


@pytest.mark.parametrize("part", [0, 0.001, 0.01, 0.3, 0.999, 0.999999])
def test_a_truncated_file_is_refused(stored: bytes, part: float, tmp_path: Path) -> None:
    path = written(tmp_path / "half.safetensors", stored[: int(part * len(stored))])
    with pytest.raises(BadField, match=r"half\.safetensors is not a readable udflow field"):
        load_field(path)


@settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 1 << 30), st.integers(0, 255)),
        min_size=1,
        max_size=4,
    )
)
def test_damage_is_refused_or_harmless(
    stored: bytes, tmp_path: Path, changes: list[tuple[bool, int, int]]
) -> None:
    """A changed number among thousands cannot be noticed; anything else is refused in words."""
    (length,) = struct.unpack("<Q", stored[:8])
    damaged = bytearray(stored)
    for in_the_header, place, value in changes:
        damaged[place % (length + 20 if in_the_header else len(stored))] = value
    path = written(tmp_path / "damaged", bytes(damaged))
    try:
        field = load_field(path)
    except BadField:
        return
    field.query(np.asarray([field.normalisation.centre]))


def test_foreign_safetensors_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "other", save({"weights": torch.zeros(3)}))
    with pytest.raises(BadField, match="holds no udflow field; fit one with udflow reconstruct"):
        load_field(path)


class Bomb:
    """Unpickling this leaves a file behind."""

    def __init__(self, sentinel: Path) -> None:
        self.sentinel = sentinel

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.sentinel,)


def test_nothing_is_ever_unpickled(tmp_path: Path) -> None:
    sentinel = tmp_path / "exploded"
    plain = written(tmp_path / "plain", pickle.dumps(Bomb(sentinel)))
    torch.save({"field": Bomb(sentinel)}, tmp_path / "torch")
    for path in (plain, tmp_path / "torch"):
        with pytest.raises(BadField):
            load_field(path)
    assert not sentinel.exists()


def test_a_folder_is_no_field(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no field at"):
        load_field(tmp_path)


def set_in_level(index: int, **values: Any) -> Callable[[Header], None]:
    return lambda header: header["levels"][index].update(values)


def set_in_header(**values: Any) -> Callable[[Header], None]:
    return lambda header: header.update(values)


HOSTILE_HEADERS: list[tuple[str, Callable[[Header], None], str]] = [
    ("another version", set_in_header(version=3), "has version 3, this release reads 2; fit it"),
    ("no version", set_in_header(version=None), "has version None"),
    ("another format", set_in_header(format="udflow-mesh"), "holds no udflow field"),
    ("more steps than levels", set_in_header(steps=6), "levels do not match"),
    ("no levels", set_in_header(steps=0, levels=[]), "levels do not match"),
    ("levels that are none", set_in_header(levels=[1, 2, 3, 4, 5]), "not a readable"),
    ("levels that are text", set_in_header(levels="abcde"), "not a readable"),
    ("a centre that is not finite", set_in_header(centre=[0, math.nan, 0]), "not finite"),
    ("a centre beyond all numbers", set_in_header(centre=[0, 10**400, 0]), "not a readable"),
    ("a centre in the plane", set_in_header(centre=[0, 0]), "not a readable"),
    ("a scale of zero", set_in_header(scale=0.0), "frame"),
    ("an infinite scale", set_in_header(scale=math.inf), "frame"),
    ("an enormous grid", set_in_level(0, shape=[4000, 4000, 4000]), "impossible grid"),
    ("a grid longer than high", set_in_level(0, shape=[30, 30, 10**12]), "impossible grid"),
    ("a negative grid", set_in_level(0, shape=[40, 40, -40]), "impossible grid"),
    ("an infinite grid", set_in_level(0, shape=[math.inf, 40, 40]), "not a readable"),
    ("a flat grid", set_in_level(0, shape=[40, 40]), "not a readable"),
    ("a grid too small for its cells", set_in_level(0, shape=[8, 8, 8]), "cells outside"),
    ("a grid wider than saved", set_in_level(0, shape=[3, 3, 3]), "cells outside"),
    ("cells of no size", set_in_level(2, spacing=0.0), "impossible grid"),
    ("cells of no number", set_in_level(2, spacing=math.nan), "impossible grid"),
    ("an origin that is not finite", set_in_level(4, origin=[0, math.inf, 0]), "impossible grid"),
    ("an origin in the plane", set_in_level(4, origin=[0, 0]), "impossible grid"),
]


@pytest.mark.parametrize(
    ("change", "words"), [h[1:] for h in HOSTILE_HEADERS], ids=[h[0] for h in HOSTILE_HEADERS]
)
def test_hostile_headers_are_refused_in_words(
    stored: bytes, tmp_path: Path, change: Callable[[Header], None], words: str
) -> None:
    header = header_of(stored)
    change(header)
    content = save(load(stored), metadata={"udflow": json.dumps(header)})
    with pytest.raises(BadField, match=words):
        load_field(written(tmp_path / "hostile", content))


@pytest.mark.parametrize("text", ["[]", "5", "null", '"field"', "{", "[" * 100_000])
def test_a_header_that_is_no_object_is_refused(stored: bytes, tmp_path: Path, text: str) -> None:
    content = save(load(stored), metadata={"udflow": text})
    with pytest.raises(BadField):
        load_field(written(tmp_path / "hostile", content))


def changed(tensors: Tensors, name: str, change: Callable[[Tensor], Tensor]) -> Tensors:
    return {**tensors, name: change(tensors[name]).contiguous()}


def with_nan(tensor: Tensor) -> Tensor:
    result = tensor.clone()
    result.view(-1)[len(result) // 2] = math.nan
    return result


def shortened(tensor: Tensor) -> Tensor:
    return tensor[1:]


HOSTILE_TENSORS: list[tuple[str, Callable[[Tensor], Tensor]]] = [
    ("level0.coefficients", shortened),
    ("level0.coefficients", with_nan),
    ("level0.coefficients", torch.Tensor.double),
    ("level0.coefficients", torch.Tensor.int),
    ("level0.faithful", shortened),
    ("level0.faithful", torch.Tensor.int),
    ("level1.cells", shortened),
    ("level1.cells", torch.Tensor.flatten),
    ("level1.cells", torch.Tensor.neg),
    ("level1.cells", torch.Tensor.float),
    ("level1.cells", lambda cells: cells[:0]),
    ("quadrics.origin", shortened),
    ("quadrics.origin", with_nan),
    ("quadrics.origin", lambda origin: origin[:0]),
    ("quadrics.origin", lambda origin: origin[0, 0]),
    ("quadrics.frame", torch.Tensor.double),
    ("quadrics.coefficients", with_nan),
    ("quadrics.radius", torch.zeros_like),
    ("quadrics.spacing", shortened),
    ("quadrics.count", shortened),
    ("quadrics.count", torch.Tensor.float),
]


@pytest.mark.parametrize(("name", "change"), HOSTILE_TENSORS)
def test_hostile_tensors_are_refused(
    stored: bytes, tmp_path: Path, name: str, change: Callable[[Tensor], Tensor]
) -> None:
    metadata = {"udflow": json.dumps(header_of(stored))}
    content = save(changed(load(stored), name, change), metadata=metadata)
    with pytest.raises(BadField, match="field"):
        load_field(written(tmp_path / "hostile", content))


@pytest.mark.parametrize("name", ["level3.cells", "level0.coefficients", "quadrics.count"])
def test_a_missing_tensor_is_noticed(stored: bytes, tmp_path: Path, name: str) -> None:
    tensors = {key: value for key, value in load(stored).items() if key != name}
    content = save(tensors, metadata={"udflow": json.dumps(header_of(stored))})
    with pytest.raises(BadField, match=name):
        load_field(written(tmp_path / "hostile", content))
