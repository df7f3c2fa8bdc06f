"""Stopping, repeating, extracting again and deleting: what is asked of jobs that exist."""

from __future__ import annotations

import time
from typing import Any

import httpx
import pytest
import redis
from api_process import ball

from jobs import keys
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.spec import JobError, JobSpec, JobState
from jobs.store import FileStore
from jobs.webhooks import Delivery, WebhookQueue
from udflow.config import preset, to_dict


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


@pytest.fixture
def done(started: str, records: JobRecords, store: FileStore) -> str:
    """The id of a succeeded job with files that only look like a result."""
    names = ("mesh.ply", "points.ply", "field.safetensors", "report.json")
    outputs = {
        name: store.put_artifact(started, 1, name, lambda path: path.write_bytes(b"{}"))
        for name in names
    }
    records.finish(started, 1, JobState.SUCCEEDED, outputs=outputs)
    return started


def test_cancel_asks_to_keep_a_partial_mesh(
    started: str, client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    answer = client.post(f"/v1/jobs/{started}/cancel", json={"keep_partial": True})
    assert (answer.status_code, answer.json()["state"]) == (202, "canceling")
    assert records.asked_to_stop(started) == "keep_partial"
    mesh = store.put_artifact(started, 1, "mesh.ply", lambda path: path.write_bytes(b"ply"))
    records.finish(started, 1, JobState.SUCCEEDED, outputs={"mesh.ply": mesh})
    job = client.get(f"/v1/jobs/{started}").json()
    assert (job["state"], job["partial"]) == ("canceled", True)
    assert client.get(f"/v1/jobs/{started}/mesh").content == b"ply"


def test_cancel_without_keeping_wins_over_keeping(
    started: str, client: httpx.Client, records: JobRecords
) -> None:
    client.post(f"/v1/jobs/{started}/cancel", json={"keep_partial": True})
    client.post(f"/v1/jobs/{started}/cancel", json={"keep_partial": True})
    assert records.asked_to_stop(started) == "keep_partial"
    client.post(f"/v1/jobs/{started}/cancel")
    assert records.asked_to_stop(started) == "at_once"
    client.post(f"/v1/jobs/{started}/cancel", json={"keep_partial": True})
    assert records.asked_to_stop(started) == "at_once"


@pytest.mark.parametrize("body", ['{"keep": true}', '{"keep_partial": 1}', "[]"])
def test_a_malformed_cancel_stops_nothing(
    body: str, started: str, client: httpx.Client, records: JobRecords
) -> None:
    assert code(client.post(f"/v1/jobs/{started}/cancel", content=body))[0] == 422
    assert records.asked_to_stop(started) == "no"


def test_retry_makes_the_same_job_again(
    started: str, client: httpx.Client, records: JobRecords
) -> None:
    assert code(client.post(f"/v1/jobs/{started}/retry")) == (409, "job_not_finished")
    records.finish(started, 1, JobState.FAILED, error=JobError("out_of_memory", "too large"))
    key = {"idempotency-key": new_id("job")}
    answer = client.post(f"/v1/jobs/{started}/retry", headers=key)
    assert answer.status_code == 202
    again, first = answer.json(), client.get(f"/v1/jobs/{started}").json()
    assert again["id"] != started
    assert answer.headers["location"] == f"/v1/jobs/{again['id']}"
    assert again["retried_from"] == started
    for name in ("scan_id", "config", "metadata", "kind"):
        assert again[name] == first[name]
    assert client.post(f"/v1/jobs/{started}/retry", headers=key).json()["id"] == again["id"]


def test_retry_needs_the_scan(
    started: str, client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    records.finish(started, 1, JobState.FAILED, error=JobError("internal", "broken"))
    scan_id = client.get(f"/v1/jobs/{started}").json()["scan_id"]
    assert client.delete(f"/v1/scans/{scan_id}?force=true").status_code == 204
    assert code(client.post(f"/v1/jobs/{started}/retry")) == (410, "gone")


def test_extract_again_keeps_what_is_not_asked(done: str, client: httpx.Client) -> None:
    box = {"low": [-1, -1, -1], "high": [1, 1, 0.5]}
    body = {"resolution": 512, "box": box, "outputs": ["mesh.glb"]}
    answer = client.post(f"/v1/jobs/{done}/extract", json=body)
    assert answer.status_code == 202, answer.text
    job, first = answer.json(), client.get(f"/v1/jobs/{done}").json()
    assert (job["kind"], job["source"]) == ("extract", done)
    expected = first["config"] | {"extract": first["config"]["extract"] | {"resolution": 512}}
    assert job["config"] == expected


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"resolution": 4}, "#/resolution"),
        ({"resolution": 64.5}, "#/resolution"),
        ({"extractor": "best"}, "#/extractor"),
        ({"box": {"low": [0, 0, 0], "high": [1, 0, 1]}}, "#/box"),
        ({"box": {"low": [0, 0, 0]}}, "#/box/high"),
        ({"box": {"low": [False, 0, 0], "high": [1, 1, 1]}}, "#/box/low/0"),
        ({"outputs": ["mesh.step"]}, "#/outputs/0"),
        ({"ttl_s": 1e9}, "#/ttl_s"),
        ({"colour": 1}, "#/colour"),
    ],
)
def test_malformed_extractions(
    body: dict[str, Any], pointer: str, done: str, client: httpx.Client
) -> None:
    answer = client.post(f"/v1/jobs/{done}/extract", json=body)
    assert code(answer) == (422, "invalid_request")
    assert answer.json()["errors"][0]["pointer"] == pointer


def test_nothing_can_be_extracted_from_an_unfinished_job(
    started: str, client: httpx.Client
) -> None:
    assert code(client.post(f"/v1/jobs/{started}/extract")) == (409, "job_not_finished")


def test_a_deleted_job_is_gone_with_its_files(
    done: str, client: httpx.Client, store: FileStore
) -> None:
    folder = store.root / "jobs" / done
    assert folder.exists()
    assert client.delete(f"/v1/jobs/{done}").status_code == 204
    assert not folder.exists()
    for path in ("", "/mesh", "/events"):
        assert code(client.get(f"/v1/jobs/{done}{path}")) == (410, "gone")
    assert client.delete(f"/v1/jobs/{done}").status_code == 204
    assert code(client.delete(f"/v1/jobs/{new_id('job')}")) == (404, "job_not_found")


def test_a_running_job_is_deleted_only_by_force(
    started: str, client: httpx.Client, records: JobRecords
) -> None:
    assert code(client.delete(f"/v1/jobs/{started}")) == (409, "job_not_finished")
    assert client.delete(f"/v1/jobs/{started}?force=true").status_code == 204
    assert not records.update(started, 1, progress=0.5)


def test_a_deleted_scan_is_gone(client: httpx.Client, store: FileStore) -> None:
    scan = client.post("/v1/scans", files={"file": ("a.npy", ball(777))}).json()
    assert client.delete(f"/v1/scans/{scan['id']}").status_code == 204
    assert not store.scan_path(scan["id"]).exists()
    assert code(client.get(f"/v1/scans/{scan['id']}")) == (410, "gone")
    assert client.delete(f"/v1/scans/{scan['id']}").status_code == 204
    assert code(client.delete(f"/v1/scans/{new_id('scan')}")) == (404, "scan_not_found")
    again = client.post("/v1/scans", files={"file": ("a.npy", ball(777))})
    assert again.status_code == 201


def test_a_scan_in_use_is_deleted_only_by_force(client: httpx.Client) -> None:
    scan = client.post("/v1/scans", files={"file": ("a.npy", ball(778))}).json()
    job = client.post("/v1/jobs", json={"scan_id": scan["id"]}).json()
    refused = client.delete(f"/v1/scans/{scan['id']}")
    assert code(refused) == (409, "scan_in_use")
    assert refused.json()["jobs"] == [job["id"]]
    assert client.delete(f"/v1/scans/{scan['id']}?force=true").status_code == 204
    assert client.get(f"/v1/jobs/{job['id']}").json()["state"] == "canceled"


def test_how_long_a_job_is_kept(
    scan: dict[str, Any], client: httpx.Client, records: JobRecords
) -> None:
    job_id = client.post("/v1/jobs", json={"scan_id": scan["id"], "ttl_s": 100}).json()["id"]
    records.claim(job_id, 1, "test", "cpu")
    records.finish(job_id, 1, JobState.FAILED, error=JobError("internal", "broken"))
    record = records.get(job_id)
    assert record is not None
    assert record.expires_at is not None
    assert record.finished_at is not None
    assert record.expires_at - record.finished_at == pytest.approx(100, abs=0.01)
    too_long = client.post("/v1/jobs", json={"scan_id": scan["id"], "ttl_s": 1e9})
    assert too_long.json()["errors"][0]["pointer"] == "#/ttl_s"


def test_only_known_files_can_be_asked_for(scan: dict[str, Any], client: httpx.Client) -> None:
    body = {"scan_id": scan["id"], "outputs": ["mesh.glb", "mesh.step"]}
    answer = client.post("/v1/jobs", json=body)
    assert answer.json()["errors"][0]["pointer"] == "#/outputs/1"


def test_webhooks_are_off_unless_configured(scan: dict[str, Any], client: httpx.Client) -> None:
    body = {"scan_id": scan["id"], "webhook": "https://example.org/hook"}
    answer = client.post("/v1/jobs", json=body)
    assert code(answer) == (422, "invalid_request")
    assert answer.json()["errors"][0] | {"message": ""} == {
        "pointer": "#/webhook",
        "code": "webhooks_off",
        "message": "",
    }


def test_what_became_of_webhooks(
    queued: str, client: httpx.Client, redis_client: redis.Redis
) -> None:
    assert client.get(f"/v1/jobs/{queued}/deliveries").json() == {"deliveries": []}
    tried = Delivery("job.started", 1e9, 1, 503, None, 1e9 + 5)
    WebhookQueue(redis_client).settle(queued, "running", tried)
    (one,) = client.get(f"/v1/jobs/{queued}/deliveries").json()["deliveries"]
    assert (one["event"], one["status"], one["attempt"]) == ("job.started", 503, 1)
    assert (one["time"], one["next_at"]) == ("2001-09-09T01:46:40Z", "2001-09-09T01:46:45Z")
    redis_client.zrem(keys.WEBHOOKS, f"{queued}:running")


def test_a_webhook_can_be_called_again(
    scan: dict[str, Any], client: httpx.Client, records: JobRecords, redis_client: redis.Redis
) -> None:
    spec = JobSpec.new(scan["id"], to_dict(preset("fast")), webhook="https://example.org/hook")
    records.create(spec)
    url, queue = f"/v1/jobs/{spec.id}/deliveries", WebhookQueue(redis_client)
    early = client.post(url)
    assert code(early) == (422, "invalid_request")
    assert early.json()["errors"][0]["pointer"] == "#/event"
    records.claim(spec.id, 1, "test", "cpu")
    records.finish(spec.id, 1, JobState.FAILED, error=JobError("internal", "broken"))
    gives_up = Delivery("job.failed", time.time(), 9, 500, None, None)
    for state in ("running", "failed"):
        queue.settle(spec.id, state, gives_up)
    assert redis_client.zscore(keys.WEBHOOKS, f"{spec.id}:failed") is None
    answer = client.post(url)
    assert (answer.status_code, len(answer.json()["deliveries"])) == (202, 2)
    assert redis_client.zscore(keys.WEBHOOKS, f"{spec.id}:failed") == 0
    assert queue.tried(spec.id, "failed") == 0
    assert redis_client.zscore(keys.WEBHOOKS, f"{spec.id}:running") is None
    assert client.post(url, json={"event": "job.started"}).status_code == 202
    assert redis_client.zscore(keys.WEBHOOKS, f"{spec.id}:running") == 0
    for body in ({"event": "job.succeeded"}, {"event": "job.paused"}, {"colour": 1}):
        assert code(client.post(url, json=body)) == (422, "invalid_request")
    for state in ("running", "failed"):
        queue.forget(spec.id, state)


def test_without_a_webhook_there_is_none_to_call(started: str, client: httpx.Client) -> None:
    answer = client.post(f"/v1/jobs/{started}/deliveries")
    assert code(answer) == (422, "invalid_request")
    assert answer.json()["errors"][0]["code"] == "no_webhook"
