"""Uploads: what is taken, what is refused, and in which words."""

from __future__ import annotations

import io
import json
import socket
import struct
import time
import zipfile
from collections.abc import Iterator

import httpx
import numpy as np
import pytest
from api_process import npy

from jobs.store import FileStore
from service.names import clean_filename

POINTS = np.random.default_rng(3).uniform(-1.0, 1.0, (400, 3))


def ply(count: int | str, body: bytes, byte_order: str = "little") -> bytes:
    header = (
        f"ply\nformat binary_{byte_order}_endian 1.0\nelement vertex {count}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + body


def zipped() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("scan.ply", ply(400, POINTS.astype("<f4").tobytes()))
    return file.getvalue()


SINGLE = POINTS.astype("<f4").tobytes()
REFUSED: dict[str, tuple[bytes, int, str, str]] = {
    # name: (bytes, status, code, a word of the explanation)
    "empty": (b"", 422, "invalid_cloud", "empty"),
    "2^31 vertices": (ply(2**31, SINGLE), 422, "invalid_cloud", "2147483648"),
    "-1 vertices": (ply(-1, SINGLE), 422, "invalid_cloud", "-1"),
    "truncated": (ply(400, SINGLE[:-100]), 422, "invalid_cloud", "bytes"),
    "wrong byte order": (ply(400, SINGLE, "big"), 422, "invalid_cloud", "byte order"),
    "all NaN": (npy(np.full((400, 3), np.nan)), 422, "invalid_cloud", "finite"),
    "all infinite": (npy(np.full((400, 3), np.inf)), 422, "invalid_cloud", "finite"),
    "all equal": (npy(np.ones((400, 3))), 422, "invalid_cloud", "equal"),
    "3 points": (npy(POINTS[:3]), 422, "invalid_cloud", "100"),
    "3 points in text": (b"0 0 0\n1 0 0\n0 1 0\n", 422, "invalid_cloud", "100"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), 415, "unknown_format", "png"),
    "zip renamed to .ply": (zipped(), 415, "unknown_format", "zip"),
    "objects": (
        npy(np.array([{"x": 1}], dtype=object)),
        422,
        "invalid_cloud",
        "",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_files_are_refused_in_words(name: str, client: httpx.Client, store: FileStore) -> None:
    data, status, code, word = REFUSED[name]
    answer = client.post("/v1/scans", files={"file": (f"{name}.ply", data)})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert word.lower() in problem["detail"].lower()
    assert "Traceback" not in answer.text
    assert list((store.root / "incoming").iterdir()) == []


@pytest.mark.parametrize("name", ["empty", "zip renamed to .ply"])
def test_bare_bodies_are_refused_alike(name: str, client: httpx.Client) -> None:
    data, status, code, word = REFUSED[name]
    answer = client.post("/v1/scans", content=data, params={"filename": "scan.ply"})
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert word.lower() in answer.json()["detail"].lower()


def test_a_scan_is_described_as_it_lies_in_the_file(client: httpx.Client) -> None:
    points = POINTS * [1.0, 2.0, 3.0] + [512_000.0, 5_403_000.0, 300.0]
    answer = client.post("/v1/scans", files={"file": ("far.npy", npy(points))})
    assert answer.status_code == 201
    scan = answer.json()
    assert answer.headers["location"] == f"/v1/scans/{scan['id']}"
    np.testing.assert_array_equal(scan["low"], points.min(axis=0))
    np.testing.assert_array_equal(scan["high"], points.max(axis=0))
    assert (scan["format"], scan["points"], scan["unique_points"]) == ("npy", 400, 400)
    assert scan["shift"] is not None
    assert scan["bytes"] == len(npy(points))
    assert client.get(answer.headers["location"]).json() == scan


def test_some_bad_points_are_left_out_and_counted(client: httpx.Client) -> None:
    points = POINTS + 7.0
    points[[3, 5]] = [[np.nan, 0, 0], [0, np.inf, 0]]
    scan = client.post("/v1/scans", content=npy(points)).json()
    assert (scan["points"], scan["dropped"]) == (398, 2)
    assert any("2" in warning for warning in scan["warnings"])


def test_the_same_bytes_again_are_the_same_scan(client: httpx.Client, store: FileStore) -> None:
    data = ply(400, (POINTS + 1).astype("<f4").tobytes())
    first = client.post("/v1/scans", files={"file": ("a.ply", data)})
    again = client.post("/v1/scans", content=data)
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json() == first.json()
    assert again.headers["location"] == first.headers["location"]
    assert list((store.root / "incoming").iterdir()) == []


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("../../etc/passwd", "passwd"),
        ("C:\\scans\\hall.ply", "hall.ply"),
        ("e\u0301cole.ply", "\u00e9cole.ply"),
        ("a\u202eylp.exe\u0000\u0007.ply", "aylp.exe.ply"),
        ("\u5c71" * 200 + ".ply", "\u5c71" * 83 + ".ply"),
        ('"><img src=x>.ply', '"><img src=x>.ply'),
        ("x" * 400, "x" * 255),
        ("\ud800.ply", ".ply"),
        ("", ""),
    ],
)
def test_names_are_cleaned(sent: str, kept: str) -> None:
    assert clean_filename(sent) == kept


def test_the_name_of_a_bare_body(client: httpx.Client) -> None:
    headers = {"content-disposition": "attachment; filename*=utf-8''hall%20%E5%B1%B1.ply"}
    scan = client.post("/v1/scans", content=npy(POINTS + 0.5), headers=headers).json()
    assert scan["filename"] == "hall \u5c71.ply"
    scan = client.post("/v1/scans?filename=../roof.las", content=npy(POINTS + 0.6)).json()
    assert scan["filename"] == "roof.las"


def test_a_long_unicode_name_in_a_form(client: httpx.Client) -> None:
    name = "\u30b9\u30ad\u30e3\u30f3" * 50 + ".ply"
    answer = client.post("/v1/scans", files={"file": (name, npy(POINTS + 31.0))})
    assert answer.status_code == 201
    assert answer.json()["filename"].startswith("\u30b9\u30ad\u30e3\u30f3")


def test_too_large_is_refused_by_its_announced_length(client: httpx.Client) -> None:
    answer = client.post("/v1/scans", content=bytes(5 << 20))
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")
    assert answer.json()["limit_bytes"] == 4 << 20


def test_too_large_is_refused_without_an_announced_length(
    client: httpx.Client, store: FileStore
) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(80):
            yield bytes(65536)

    answer = client.post("/v1/scans", content=chunks())
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")
    assert list((store.root / "incoming").iterdir()) == []


def test_compressed_bodies_are_refused(client: httpx.Client) -> None:
    answer = client.post("/v1/scans", content=b"x", headers={"content-encoding": "gzip"})
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported_media_type")


def form(*parts: tuple[str, bytes], end: bytes = b"--B--\r\n") -> bytes:
    return (
        b"".join(
            b"--B\r\nContent-Disposition: form-data; "
            + head.encode()
            + b"\r\n\r\n"
            + body
            + b"\r\n"
            for head, body in parts
        )
        + end
    )


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (form(('name="file"; filename="a"', b"x"), end=b""), 400, "malformed_request"),
        (b"nonsense", 400, "malformed_request"),
        (form(), 422, "invalid_request"),
        (form(('name="cloud"; filename="a"', b"x")), 422, "invalid_request"),
        (form(('name="file"', b"x")), 422, "invalid_request"),
        (form(*[('name="file"; filename="a"', b"x")] * 2), 422, "invalid_request"),
        (
            form(('name="preset"', b"fast"), ('name="file"; filename="a"', b"x")),
            422,
            "invalid_request",
        ),
        (form(*[(f'name="f{i}"', b"x") for i in range(50)]), 400, "malformed_request"),
        (form(("", b"x")), 400, "malformed_request"),
    ],
    ids=[
        "cut",
        "no form",
        "no part",
        "wrong part",
        "no file",
        "two files",
        "extra",
        "50",
        "unnamed",
    ],
)
def test_malformed_forms(body: bytes, status: int, code: str, client: httpx.Client) -> None:
    headers = {"content-type": "multipart/form-data; boundary=B"}
    answer = client.post("/v1/scans", content=body, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text


def test_a_form_without_boundary(client: httpx.Client) -> None:
    answer = client.post("/v1/scans", content=b"x", headers={"content-type": "multipart/form-data"})
    assert answer.status_code == 400


def test_a_body_that_stops_arriving_is_given_up(client: httpx.Client, store: FileStore) -> None:
    url = client.base_url
    with socket.create_connection((url.host, url.port), timeout=10) as raw:
        raw.sendall(
            b"POST /v1/scans HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nshort"
        )
        reply = b"".join(iter(lambda: raw.recv(4096), b""))
    head, _, body = reply.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 408")
    assert json.loads(body)["code"] == "request_timeout"
    assert list((store.root / "incoming").iterdir()) == []


def test_a_client_that_goes_away_leaves_nothing(client: httpx.Client, store: FileStore) -> None:
    url = client.base_url
    with socket.create_connection((url.host, url.port)) as raw:
        raw.sendall(b"POST /v1/scans HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99\r\n\r\nab")
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    deadline = time.monotonic() + 5
    while list((store.root / "incoming").iterdir()):
        assert time.monotonic() < deadline, "the upload was left behind"
        time.sleep(0.02)


@pytest.mark.parametrize("scan_id", ["nope", "scan_" + "0" * 36, "job_" + "0" * 36, "..%2f..%2fx"])
def test_unknown_scans(scan_id: str, client: httpx.Client) -> None:
    answer = client.get(f"/v1/scans/{scan_id}")
    assert answer.status_code == 404
    assert answer.json()["code"] in ("scan_not_found", "not_found")
