"""Errors that no other test meets, and the list of all that are met."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball

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


@pytest.fixture(scope="module")
def full(api_redis: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """A service whose queue takes no job and whose disk has no room."""
    folder = tmp_path_factory.mktemp("full")
    shared = Settings(data=folder / "data", redis_url=f"{api_redis.url}?db=5")
    limits = {"UDFLOW_QUEUE_LIMIT": "0", "UDFLOW_MIN_FREE_MB": str(10**9)}
    with ApiProcess(shared, folder / "log", limits) as running:
        yield running


def test_a_full_queue(full: Api) -> None:
    answer = httpx.post(f"{full.url}/v1/jobs", files={"file": ("a.npy", ball())}, timeout=30)
    assert code(answer) == (429, "queue_full")
    assert int(answer.headers["retry-after"]) > 0


def test_a_full_disk(full: Api) -> None:
    headers = {"Tus-Resumable": "1.0.0", "Upload-Length": "100"}
    assert code(httpx.post(f"{full.url}/v1/uploads", headers=headers)) == (507, "storage_full")


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


def test_every_code_is_met_by_some_test() -> None:
    folders = (TESTS / "service", TESTS / "end_to_end")
    text = "".join(path.read_text() for folder in folders for path in folder.glob("test_*.py"))
    assert [name for name in PROBLEMS if f'"{name}"' not in text] == []
