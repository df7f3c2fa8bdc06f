"""Errors that no other test meets, and the list of all that are met."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import torch
from api_process import Api, ApiProcess, ball
from safetensors.torch import save as to_bytes

from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobState
from jobs.store import FileStore
from service.problems import PROBLEMS

TESTS = Path(__file__).resolve().parents[1]


def code(answer: httpx.Response) -> tuple[int, str]:
    assert answer.headers["content-type"] == "application/problem+json"
    return answer.status_code, answer.json()["code"]


def test_a_full_queue(api_redis: EmbeddedRedis, tmp_path: Path) -> None:
    shared = Settings(data=tmp_path / "data", redis_url=f"{api_redis.url}?db=5")
    with ApiProcess(shared, tmp_path / "log", {"UDFLOW_QUEUE_LIMIT": "0"}) as full:
        answer = httpx.post(f"{full.url}/v1/jobs", files={"file": ("a.npy", ball())}, timeout=30)
    assert code(answer) == (429, "queue_full")
    assert int(answer.headers["retry-after"]) > 0


def test_a_disk_below_its_floor_takes_nothing_and_keeps_what_it_has(
    api_redis: EmbeddedRedis, tmp_path: Path
) -> None:
    shared = Settings(data=tmp_path / "data", redis_url=f"{api_redis.url}?db=5")
    store = FileStore(shared.data)
    with store.receive() as upload:
        upload.write(ball())
        about = {"filename": "", "format": "npy", "points": 500}
        scan_id = store.add_scan(upload, about).id
    before = sorted(shared.data.rglob("*"))
    with ApiProcess(shared, tmp_path / "log", {"UDFLOW_MIN_FREE_MB": str(10**9)}) as full:
        tus = {"Tus-Resumable": "1.0.0", "Upload-Length": "100"}
        job, scan = {"scan_id": scan_id}, {"file": ("a.npy", ball())}
        answers = [
            httpx.post(f"{full.url}/v1/uploads", headers=tus),
            httpx.post(f"{full.url}/v1/scans", files=scan),
            httpx.post(f"{full.url}/v1/scans", content=ball(501)),
            httpx.post(f"{full.url}/v1/jobs", files=scan),
            httpx.post(f"{full.url}/v1/jobs", json=job),
        ]
        assert [code(answer) for answer in answers] == [(507, "storage_full")] * 5
        checks = httpx.get(f"{full.url}/readyz").json()["checks"]
        assert [check["ok"] for check in checks if check["name"] == "disk"] == [False]
    after = [path for path in sorted(shared.data.rglob("*")) if path.name != "uploads"]
    assert [path for path in after if path.name != "secret.key"] == before
    assert store.scan_path(scan_id).read_bytes() == ball()


def test_the_wrong_method_is_told_the_right_ones(client: httpx.Client) -> None:
    answer = client.put("/v1/jobs")
    assert code(answer) == (405, "method_not_allowed")
    assert answer.headers["allow"] == "GET, POST"
    one = client.put(f"/v1/uploads/{new_id('upload')}")
    assert one.headers["allow"] == "DELETE, GET, HEAD, PATCH"


def test_another_host(client: httpx.Client) -> None:
    answer = client.get("/v1/info", headers={"host": "scans.example"})
    assert code(answer) == (421, "host_not_allowed")


def test_a_damaged_field(
    started: str, client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    name = "field.safetensors"
    field = store.put_artifact(started, 1, name, lambda path: path.write_bytes(b"noise"))
    records.finish(started, 1, JobState.SUCCEEDED, outputs={name: field})
    for path, body in (("udf", {"points": [[0, 0, 0]]}), ("udf/slice", {})):
        answer = client.post(f"/v1/jobs/{started}/{path}", json=body)
        assert code(answer) == (500, "artifact_damaged")


def test_a_field_of_another_release(
    started: str, client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    header = json.dumps({"format": "udflow-spline-field", "version": 1})
    content = to_bytes({"nothing": torch.zeros(1)}, metadata={"udflow": header})
    name = "field.safetensors"
    field = store.put_artifact(started, 1, name, lambda path: path.write_bytes(content))
    records.finish(started, 1, JobState.SUCCEEDED, outputs={name: field})
    for path, body in (("udf", {"points": [[0, 0, 0]]}), ("udf/slice", {})):
        answer = client.post(f"/v1/jobs/{started}/{path}", json=body)
        assert code(answer) == (409, "outdated_field")
        assert "version 1" in answer.json()["detail"]


def test_a_file_whose_bytes_have_changed_is_not_served(
    started: str, client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    name, content = "mesh.ply", b"ply" + bytes(1000)
    mesh = store.put_artifact(started, 1, name, lambda path: path.write_bytes(content))
    records.finish(started, 1, JobState.SUCCEEDED, outputs={name: mesh})
    address = f"/v1/jobs/{started}/mesh"
    assert client.get(address).content == content
    path = store.artifact_path(mesh)
    for damaged in (b"plY" + content[3:], content[:-1], content + b"\0"):
        path.write_bytes(damaged)
        answer = client.get(address)
        assert code(answer) == (500, "artifact_damaged")
        assert "SHA-256" in answer.json()["detail"]
    path.write_bytes(content)
    assert client.get(address).content == content


def test_a_mistake_of_the_service_is_logged_under_its_request_id(
    scan: dict[str, Any], client: httpx.Client, store: FileStore, api: Api
) -> None:
    manifest = store.scan_path(scan["id"]).with_name("scan.json")
    good = manifest.read_text()
    manifest.write_text("{}")  # nothing of the service writes this
    try:
        answer = client.get(f"/v1/scans/{scan['id']}")
    finally:
        manifest.write_text(good)
    assert code(answer) == (500, "internal_error")
    assert "KeyError" in api.log.read_text()
    assert "KeyError" not in answer.text


def _asserted(path: Path) -> Iterator[object]:
    """The constants that a test file asserts, itself or by its parameters."""
    for node in ast.walk(ast.parse(path.read_text())):
        is_table = isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "parametrize"
        if isinstance(node, ast.Assert) or is_table:
            yield from (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))


def test_every_code_is_asserted_by_some_test_that_reads_it() -> None:
    folders = (TESTS / "service", TESTS / "end_to_end")
    files = [path for folder in folders for path in folder.glob("test_*.py")]
    readers = [path for path in files if re.search(r'\["code"\]|\.code\b', path.read_text())]
    met = {value for path in readers for value in _asserted(path)}
    assert [name for name in PROBLEMS if name not in met] == []
