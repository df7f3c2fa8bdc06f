"""Planes through a fitted sphere: the grid is where it says, the picture shows the circle."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import httpx
import numpy as np
import pytest
from user_steps import RADIUS, Finished


@pytest.fixture
def address(finished: Finished) -> str:
    return f"/v1/jobs/{finished.id}/udf/slice"


def centres(answer: httpx.Response, shape: tuple[int, ...]) -> Any:
    """Where the cells lie, by the headers."""
    first, right, down = (
        np.array([float(x) for x in answer.headers[f"x-slice-{name}"].split(",")])
        for name in ("first", "right", "down")
    )
    row, column = np.mgrid[: shape[0], : shape[1]]
    return first + column[..., None] * right + row[..., None] * down


def pixels(png: bytes) -> Any:
    width, height = struct.unpack(">II", png[16:24])
    data = zlib.decompress(png[png.index(b"IDAT") + 4 : -16])
    return (
        np.frombuffer(data, np.uint8)
        .reshape(height, 1 + 4 * width)[:, 1:]
        .reshape(height, width, 4)
    )


PLANES: list[dict[str, Any]] = [
    {},
    {"axis": "x", "at": 0.5},
    {"axis": "y"},
    {"origin": [0.3, 0, 0], "normal": [1, 1, 0.5], "up": [0, 0, 1], "width": 6, "height": 3},
]


@pytest.mark.parametrize("plane", PLANES)
def test_distances_lie_where_the_headers_say(
    plane: dict[str, Any], address: str, client: httpx.Client
) -> None:
    answer = client.post(address, json=plane | {"resolution": 60})
    assert answer.status_code == 200, answer.text
    grid = np.load(io.BytesIO(answer.content))
    assert grid.dtype == np.float32
    assert max(grid.shape) == 60
    radius = np.linalg.norm(centres(answer, grid.shape), axis=2)
    far = radius > 0.6 * RADIUS
    np.testing.assert_allclose(grid[far], np.abs(radius - RADIUS)[far], atol=0.03 * RADIUS)
    assert far.any()


def test_up_is_up_and_right_is_right(address: str, client: httpx.Client) -> None:
    for axis, right, up in (("z", 0, 1), ("y", 0, 2), ("x", 1, 2)):
        answer = client.post(address, json={"axis": axis, "resolution": 8})
        places = centres(answer, (8, 8))
        assert (np.diff(places[..., right], axis=1) > 0).all()
        assert (np.diff(places[..., up], axis=0) < 0).all()


def test_a_wide_plane(address: str, client: httpx.Client) -> None:
    answer = client.post(address, json={"width": 6, "height": 1.5, "resolution": 40})
    assert np.load(io.BytesIO(answer.content)).shape == (10, 40)


def test_the_picture_shows_the_surface_and_lines(address: str, client: httpx.Client) -> None:
    query = {"axis": "z", "at": 0, "resolution": 200}
    answer = client.get(address, params=query)
    assert answer.headers["content-type"] == "image/png"
    image = pixels(answer.content).astype(int)
    radius = np.linalg.norm(centres(answer, image.shape), axis=2)
    red = (image[..., 0] > 230) & (image[..., 2] < 90)
    assert red.sum() > 150
    assert (np.abs(radius[red] - RADIUS) < 0.03 * RADIUS).all()
    step = float(answer.headers["x-isoline-step"])
    assert step in (0.1, 0.2, 0.5)
    plain = pixels(client.get(address, params=query | {"isolines": False}).content).astype(int)
    darker = (plain - image)[..., :3].sum(axis=2) > 60
    away = np.abs(radius[darker] - RADIUS)
    off = np.abs(away / step - np.rint(away / step))
    outside = radius[darker] > 0.6 * RADIUS
    assert outside.sum() > 500
    assert np.median(off[outside]) < 0.2


@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ({"axis": "w"}, "?axis"),
        ({"at": 1}, "?"),
        ({"resolution": 1}, "?resolution"),
        ({"resolution": 100_000}, "?resolution"),
        ({"axis": "z", "at": "nan"}, "?at"),
        ({"format": "jpg"}, "?format"),
    ],
)
def test_impossible_planes_by_address(
    query: dict[str, Any], pointer: str, address: str, client: httpx.Client
) -> None:
    answer = client.get(address, params=query)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request"), answer.text
    assert answer.json()["errors"][0]["pointer"].startswith(pointer)


@pytest.mark.parametrize(
    "body",
    [
        {"normal": [0, 0, 0]},
        {"normal": [0, 0, 1], "up": [0, 0, 2]},
        {"axis": "z", "normal": [0, 0, 1]},
        {"width": 1},
        {"width": -1, "height": 1},
        {"planes": 3},
    ],
)
def test_impossible_planes(body: dict[str, Any], address: str, client: httpx.Client) -> None:
    answer = client.post(address, json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request"), answer.text
