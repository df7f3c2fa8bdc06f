"""Distance queries over HTTP: each form agrees with the others, and wrong ones are refused."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from api_process import npy
from user_steps import RADIUS, Finished, sphere, submit, wait

POINTS = sphere(300, seed=11) * np.linspace(0.8, 1.15, 300)[:, None]


@pytest.fixture
def ask(finished: Finished, client: httpx.Client) -> Any:
    def post(content: bytes | None = None, **options: Any) -> httpx.Response:
        return client.post(f"/v1/jobs/{finished.id}/udf", content=content, **options)

    return post


def loaded(answer: httpx.Response) -> Any:
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content), allow_pickle=False)


def test_json_and_binary_agree(ask: Any) -> None:
    body = {"points": POINTS.tolist(), "gradients": True, "closest": True}
    told = ask(json=body).json()
    assert told["count"] == 300
    distances = loaded(ask(npy(POINTS)))
    np.testing.assert_array_equal(distances, told["distance"])
    every = {"gradients": True, "closest": True}
    records = loaded(ask(npy(POINTS), params=every))
    assert records.dtype.names == ("distance", "gradient", "closest", "valid")
    for mine, theirs in (
        ("distance", "distance"),
        ("gradient", "gradient"),
        ("closest", "closest"),
    ):
        np.testing.assert_allclose(records[mine], told[theirs], atol=1e-7)
    assert records["valid"].tolist() == told["valid"]
    bare = ask(POINTS.astype("<f8").tobytes(), params=every | {"dtype": "float64"})
    assert bare.headers["x-shape"] == "300,8"
    assert bare.headers["x-columns"].split(",")[0] == "distance"
    rows = np.frombuffer(bare.content, "<f8").reshape(300, 8)
    np.testing.assert_array_equal(rows[:, 0], distances)
    np.testing.assert_array_equal(rows[:, 4:7], records["closest"])


def test_distances_are_right(ask: Any) -> None:
    answer = ask(json={"points": POINTS.tolist(), "gradients": True, "closest": True}).json()
    radii = np.linalg.norm(POINTS, axis=1)
    np.testing.assert_allclose(answer["distance"], np.abs(radii - RADIUS), atol=0.02 * RADIUS)
    feet = np.linalg.norm(answer["closest"], axis=1)
    np.testing.assert_allclose(feet, RADIUS, atol=0.01 * RADIUS)
    lengths = np.linalg.norm(answer["gradient"], axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    "data",
    [
        npy(POINTS.astype("<f4")),
        npy(POINTS.astype(">f8")),
        npy(np.asfortranarray(POINTS)),
    ],
    ids=["float32", "big-endian", "column-major"],
)
def test_arrays_as_numpy_users_have_them(data: bytes, ask: Any) -> None:
    expected = loaded(ask(npy(POINTS)))
    np.testing.assert_allclose(loaded(ask(data)), expected, atol=1e-5)


def test_bare_single_precision(ask: Any) -> None:
    answer = ask(
        POINTS.astype("<f4").tobytes(),
        params={"dtype": "float32"},
        headers={"x-shape": "300,3", "content-type": "application/octet-stream"},
    )
    assert answer.headers["x-dtype"] == "float32"
    found = np.frombuffer(answer.content, "<f4")
    np.testing.assert_allclose(found, loaded(ask(npy(POINTS))), atol=1e-5)


def test_accept_chooses_the_form(ask: Any) -> None:
    expected = loaded(ask(npy(POINTS)))
    told = ask(npy(POINTS), headers={"accept": "application/json"}).json()
    np.testing.assert_array_equal(told["distance"], expected)
    array = ask(json={"points": POINTS.tolist()}, headers={"accept": "application/x-npy"})
    np.testing.assert_array_equal(loaded(array), expected)


@pytest.mark.parametrize("empty", [[], np.empty((0, 3))], ids=["json", "npy"])
def test_no_points_have_no_distances(empty: Any, ask: Any) -> None:
    if isinstance(empty, list):
        assert ask(json={"points": empty}).json()["distance"] == []
    else:
        assert loaded(ask(npy(empty))).shape == (0,)


def test_points_outside_the_box_are_marked(ask: Any) -> None:
    answer = ask(json={"points": [[0, 0, RADIUS], [0, 0, 100 * RADIUS]]}).json()
    assert answer["valid"] == [True, False]
    assert answer["distance"][1] == pytest.approx(99 * RADIUS, rel=0.05)


def bad(row: int, value: float) -> Any:
    points = POINTS.copy()
    points[row, 1] = value
    return points


@pytest.mark.parametrize(
    ("data", "row"),
    [
        (npy(bad(7, np.nan)), 7),
        (npy(bad(299, np.inf)), 299),
        (npy(bad(3, 1e300)), 3),
        (b'{"points": [[0,0,0],[0,0]]}', 1),
        (b'{"points": [[0,0,0],[0,0,0],["0",0,0]]}', 2),
        (b'{"points": [[0,0,true]]}', 0),
        (b'{"points": [[0,0,0],null]}', 1),
        (b'{"points": [[0,0,0],[0,0,1e999]]}', 1),
    ],
)
def test_the_first_bad_row_is_named(data: bytes, row: int, ask: Any) -> None:
    answer = ask(data)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, "invalid_query"), answer.text
    assert problem["row"] == row
    assert problem["errors"][0]["pointer"] == f"#/points/{row}"


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"", 400),
        (b"{", 400),
        (b'{"points": [[0,0,NaN]]}', 400),
        (b"[]", 422),
        (b'{"points": 3}', 422),
        (b"{}", 422),
        (b'{"points": [], "gradients": 1}', 422),
        (b'{"points": [], "colour": true}', 422),
        (b'{"points": [[0,0,1%s]]}' % (b"0" * 400), 422),
        (npy(POINTS)[:-1], 422),
        (npy(POINTS) + b"x", 422),
        (npy(POINTS)[:40], 422),
        (b"\x93NUMPY\x09\x00" + bytes(100), 422),
        (b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, 422),
        (npy(POINTS[:, :2]), 422),
        (npy(POINTS[0]), 422),
        (npy(np.array([[object(), 1, 2]], dtype=object)), 422),
        (npy(POINTS.astype("<c16")), 422),
        (npy(np.array([["a", "b", "c"]])), 422),
    ],
)
def test_malformed_questions(data: bytes, status: int, ask: Any) -> None:
    answer = ask(data)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.json()["detail"]) > 15


@pytest.mark.parametrize(
    ("size", "query", "shape"),
    [
        (35, {"dtype": "float32"}, None),
        (36, {"dtype": "float32"}, "4,3"),
        (36, {"dtype": "float32"}, "3,4"),
        (36, {"dtype": "int8"}, None),
        (36, {}, None),
    ],
)
def test_malformed_bare_numbers(
    size: int, query: dict[str, str], shape: str | None, ask: Any
) -> None:
    headers = {"content-type": "application/octet-stream"} | ({"x-shape": shape} if shape else {})
    answer = ask(bytes(size), params=query, headers=headers)
    assert answer.status_code == 422, answer.text


def test_too_many_points_for_json(ask: Any) -> None:
    many = b'{"points": [' + b",".join([b"[0,0,0]"] * 100_001) + b"]}"
    answer = ask(many)
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")
    assert "npy" in answer.json()["detail"]
    binary = ask(npy(np.zeros((100_001, 3))), headers={"accept": "application/json"})
    assert binary.status_code == 413


def test_a_header_that_promises_too_many_points(ask: Any) -> None:
    file = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**40, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    assert ask(file.getvalue()).status_code == 413


def test_a_million_points(ask: Any) -> None:
    points = np.random.default_rng(2).uniform(-1.1 * RADIUS, 1.1 * RADIUS, (1_000_000, 3))
    began = time.monotonic()
    distances = loaded(ask(npy(points)))
    assert distances.shape == (1_000_000,)
    far = np.linalg.norm(points, axis=1) > 0.6 * RADIUS  # the centre is as far from everywhere
    exact = np.abs(np.linalg.norm(points, axis=1) - RADIUS)
    np.testing.assert_allclose(distances[far], exact[far], atol=0.03 * RADIUS)
    assert time.monotonic() - began < 60


def test_queries_are_answered_while_a_job_fits(
    finished: Finished, ask: Any, client: httpx.Client
) -> None:
    busy = submit(client, sphere(3000, seed=4), extract={"resolution": 64}, densify={})
    answers = 0
    while client.get(f"/v1/jobs/{busy}").json()["state"] in ("queued", "running"):
        assert loaded(ask(npy(POINTS[:10]))).shape == (10,)
        answers += 1
    assert answers > 3
    assert wait(client, busy)["state"] == "succeeded"


def test_a_short_question_does_not_wait_for_long_ones(
    finished: Finished, url: str, ask: Any
) -> None:
    points = npy(np.random.default_rng(1).uniform(-1, 1, (400_000, 3)).astype("<f4"))
    ends: list[float] = []

    def long() -> None:
        with httpx.Client(base_url=url, timeout=70) as client:
            client.post(f"/v1/jobs/{finished.id}/udf", content=points)
            ends.append(time.monotonic())

    threads = [threading.Thread(target=long) for _ in range(3)]
    for thread in threads:
        thread.start()
    time.sleep(0.3)
    assert loaded(ask(npy(POINTS[:5]))).shape == (5,)
    short = time.monotonic()
    for thread in threads:
        thread.join()
    assert short < min(ends)


def test_whoever_stops_reading_harms_nobody(finished: Finished, url: str, ask: Any) -> None:
    points = npy(np.zeros((2_000_000, 3), "<f4"))

    def chunks() -> Iterator[bytes]:
        yield points

    with httpx.Client(base_url=url, timeout=30) as client:
        path = f"/v1/jobs/{finished.id}/udf"
        with client.stream("POST", path, content=chunks()) as answer:
            assert answer.status_code == 200
    assert loaded(ask(npy(POINTS[:5]))).shape == (5,)
