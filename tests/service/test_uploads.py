"""Resumable uploads: the tus protocol, broken lines, restarts."""

from __future__ import annotations

import base64
import socket
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from api_process import Api, ApiProcess, npy

from jobs.ids import new_id
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.uploads import UploadStore

TUS = {"Tus-Resumable": "1.0.0"}
CHUNK = TUS | {"Content-Type": "application/offset+octet-stream"}


def cloud(count: int, seed: int) -> bytes:
    return npy(np.random.default_rng(seed).normal(size=(count, 3)))


def begin(client: httpx.Client, length: int, **headers: str) -> httpx.Response:
    return client.post("/v1/uploads", headers=TUS | {"Upload-Length": str(length)} | headers)


def send(client: httpx.Client, address: str, offset: int, data: bytes) -> httpx.Response:
    headers = CHUNK | {"Upload-Offset": str(offset)}
    return client.patch(address, headers=headers, content=data)


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def test_what_is_spoken(client: httpx.Client) -> None:
    answer = client.options("/v1/uploads")
    assert answer.status_code == 204
    assert answer.headers["tus-version"] == "1.0.0"
    assert set(answer.headers["tus-extension"].split(",")) == {
        *("creation", "creation-with-upload", "expiration", "termination")
    }
    assert int(answer.headers["tus-max-size"]) == 4 << 20


def test_a_scan_comes_in_pieces(client: httpx.Client) -> None:
    data = cloud(600, 1)
    name = base64.b64encode("halle ä.npy".encode()).decode()
    made = begin(client, len(data), **{"Upload-Metadata": f"filename {name},private"})
    assert made.status_code == 201
    address = made.headers["location"]
    assert made.headers["upload-offset"] == "0"
    assert "upload-expires" in made.headers
    offset = 0
    for end in (1000, 1000, 9000, len(data)):
        answer = send(client, address, offset, data[offset:end])
        assert answer.status_code == 204, answer.text
        assert answer.headers["upload-offset"] == str(end)
        offset = end
        head = client.head(address, headers=TUS)
        assert head.headers["upload-offset"] == str(end)
        assert head.headers["upload-length"] == str(len(data))
        assert head.headers["cache-control"] == "no-store"
    scan = client.get(answer.headers["upload-scan"]).json()
    assert (scan["points"], scan["filename"]) == (600, "halle ä.npy")
    state = client.get(address).json()
    assert (state["offset"], state["scan"]["id"]) == (len(data), scan["id"])
    job = client.post("/v1/jobs", json={"scan_id": scan["id"]})
    assert job.status_code == 202
    again = client.post("/v1/scans", content=data)
    assert (again.status_code, again.json()["id"]) == (200, scan["id"])


def test_all_in_the_first_request(client: httpx.Client) -> None:
    data = cloud(300, 2)
    headers = CHUNK | {"Upload-Length": str(len(data))}
    made = client.post("/v1/uploads", headers=headers, content=data)
    assert made.status_code == 201
    assert client.get(made.headers["upload-scan"]).json()["points"] == 300


def test_the_bytes_before_a_broken_line_are_kept(client: httpx.Client, api: Api) -> None:
    data = cloud(5000, 3)
    address = begin(client, len(data)).headers["location"]
    host, port = api.url.removeprefix("http://").split(":")
    head = f"PATCH {address} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(data)}\r\n"
    head += "".join(f"{name}: {value}\r\n" for name, value in CHUNK.items())
    with socket.create_connection((host, int(port))) as line:
        line.sendall(head.encode() + b"Upload-Offset: 0\r\n\r\n" + data[:50_000])
        time.sleep(0.3)
    deadline = time.monotonic() + 5
    offset = 0
    while offset == 0 and time.monotonic() < deadline:
        time.sleep(0.05)
        offset = int(client.head(address, headers=TUS).headers["upload-offset"])
    assert 0 < offset <= 50_000
    answer = send(client, address, offset, data[offset:])
    while answer.status_code == 423 and time.monotonic() < deadline:
        answer = send(client, address, offset, data[offset:])
    assert answer.status_code == 204
    assert client.get(answer.headers["upload-scan"]).json()["points"] == 5000


def test_two_writers_at_once(client: httpx.Client, api: Api) -> None:
    data = cloud(400, 4)
    address = begin(client, len(data)).headers["location"]
    uploads = UploadStore(api.shared.data.resolve(), 60.0)
    with uploads.writing(address.rpartition("/")[2]):
        assert code(send(client, address, 0, data)) == (423, "upload_locked")
    assert send(client, address, 0, data).status_code == 204


def test_it_survives_a_restart(api_redis: EmbeddedRedis, tmp_path: Path) -> None:
    shared = Settings(data=tmp_path / "data", redis_url=f"{api_redis.url}?db=3")
    data = cloud(700, 5)
    for end in (len(data) // 2, len(data)):
        with (
            ApiProcess(shared, tmp_path / "log", {}) as api,
            httpx.Client(base_url=api.url, timeout=30) as client,
        ):
            if end < len(data):
                address = begin(client, len(data)).headers["location"]
            offset = int(client.head(address, headers=TUS).headers["upload-offset"])
            answer = send(client, address, offset, data[offset:end])
            assert answer.status_code == 204
    assert offset == len(data) // 2
    assert "upload-scan" in answer.headers


def test_a_restart_before_the_scan_was_made(client: httpx.Client, api: Api) -> None:
    """All bytes are there, but the process died before it read them."""
    data = cloud(450, 6)
    address = begin(client, len(data)).headers["location"]
    UploadStore(api.shared.data.resolve(), 60.0).data(address.rpartition("/")[2]).write_bytes(data)
    assert client.get(address).json()["scan"]["points"] == 450


def test_what_is_no_scan_is_refused_at_the_end(client: httpx.Client) -> None:
    data = b"ply\nformat ascii 1.0\nelement vertex 9\n"
    address = begin(client, len(data)).headers["location"]
    answer = send(client, address, 0, data)
    assert code(answer) == (422, "invalid_cloud")
    assert "header" in answer.json()["detail"]
    state = client.get(address).json()
    assert (state["scan"], state["error"]["code"]) == (None, "invalid_cloud")
    head = client.head(address, headers=TUS)
    assert head.headers["upload-offset"] == str(len(data))


def test_an_upload_can_be_given_up(client: httpx.Client) -> None:
    address = begin(client, 100).headers["location"]
    assert client.delete(address, headers=TUS).status_code == 204
    assert code(client.get(address)) == (410, "gone")
    assert code(client.delete(address, headers=TUS)) == (410, "gone")
    assert code(client.get(f"/v1/uploads/{new_id('upload')}")) == (404, "upload_not_found")
    assert code(client.get("/v1/uploads/..%2f..")) == (404, "not_found")


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"Tus-Resumable": "0.2.2", "Upload-Length": "5"}, (412, "tus_version")),
        ({"Upload-Length": "5"}, (412, "tus_version")),
        (TUS, (422, "invalid_request")),
        (TUS | {"Upload-Length": "-5"}, (422, "invalid_request")),
        (TUS | {"Upload-Length": "x"}, (422, "invalid_request")),
        (TUS | {"Upload-Length": "0"}, (422, "invalid_cloud")),
        (TUS | {"Upload-Length": str(5 << 20)}, (413, "body_too_large")),
        (TUS | {"Upload-Length": "5", "Upload-Metadata": "filename ?"}, (422, "invalid_request")),
    ],
)
def test_uploads_that_cannot_begin(
    headers: dict[str, str], expected: Any, client: httpx.Client
) -> None:
    answer = client.post("/v1/uploads", headers=headers)
    assert code(answer) == expected
    if expected[0] == 412:
        assert answer.headers["tus-version"] == "1.0.0"


def test_pieces_that_do_not_fit(client: httpx.Client) -> None:
    address = begin(client, 10).headers["location"]
    conflict = send(client, address, 3, b"abc")
    assert code(conflict) == (409, "upload_conflict")
    assert conflict.headers["upload-offset"] == "0"
    assert code(send(client, address, 0, b"0123456789abc")) == (413, "body_too_large")
    other = client.patch(address, headers=TUS | {"Upload-Offset": "0"}, content=b"a")
    assert code(other) == (415, "unsupported_media_type")
    assert code(client.patch(address, headers=CHUNK, content=b"a")) == (422, "invalid_request")
