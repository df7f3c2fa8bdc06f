"""Jobs: what is taken, what is refused, how they are looked at and stopped."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import httpx
import pytest
from api_process import ball

from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.spec import JobError, JobState
from jobs.store import FileStore
from udflow.config import preset, to_dict


def post_job(client: httpx.Client, scan: dict[str, Any], **changes: Any) -> httpx.Response:
    return client.post("/v1/jobs", json={"scan_id": scan["id"], "preset": "fast", **changes})


def test_a_job_is_taken_with_its_complete_configuration(
    client: httpx.Client, scan: dict[str, Any]
) -> None:
    config = {"extract": {"resolution": 32}, "seed": 7}
    answer = post_job(client, scan, config=config, metadata={"room": "hall"})
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert "retry-after" in answer.headers
    complete = to_dict(preset("fast"))
    complete["extract"]["resolution"] = 32
    complete["seed"] = 7
    assert job["config"] == complete
    assert job["metadata"] == {"room": "hall"}
    assert (job["state"], job["progress"], job["scan_id"]) == ("queued", 0.0, scan["id"])
    assert job["queue_position"] >= 1
    assert job["links"]["events"] == f"/v1/jobs/{job['id']}/events"
    assert client.get(answer.headers["location"]).json() == job


def test_upload_and_job_in_one_go(client: httpx.Client) -> None:
    form = {"preset": "fast", "config": '{"extract": {"resolution": 48}}', "metadata": '{"a": "b"}'}
    answer = client.post("/v1/jobs", data=form, files={"file": ("ball.npy", ball())})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert (job["config"]["extract"]["resolution"], job["metadata"]) == (48, {"a": "b"})
    assert client.get(job["links"]["scan"]).json()["points"] == 500


def test_a_file_alone_is_enough(client: httpx.Client) -> None:
    answer = client.post("/v1/jobs", files={"file": ("ball.npy", ball())})
    assert answer.status_code == 202
    assert answer.json()["config"] == to_dict(preset("fast"))


@pytest.mark.parametrize(
    ("body", "pointer", "code"),
    [
        ({"preset": "best"}, "#/preset", "unknown_preset"),
        ({"preset": 3}, "#/preset", "invalid_value"),
        ({"colour": "red"}, "#/colour", "unknown_key"),
        ({"config": {"colour": 1}}, "#/config/colour", "unknown_key"),
        ({"config": {"extract": {"size": 1}}}, "#/config/extract/size", "unknown_key"),
        ({"config": {"a/b~": 1}}, "#/config/a~1b~0", "unknown_key"),
        ({"config": {"extract": {"resolution": 100_000}}}, "#/config/extract/resolution", None),
        ({"config": {"extract": {"resolution": "64"}}}, "#/config/extract/resolution", None),
        ({"config": {"extract": {"resolution": 64.5}}}, "#/config/extract/resolution", None),
        ({"config": {"extract": 64}}, "#/config/extract", None),
        ({"config": {"seed": -1}}, "#/config/seed", None),
        ({"config": {"flow": {"steps": 0}}}, "#/config/flow/steps", None),
        ({"config": {"densify": {"threshold": -0.005}}}, "#/config/densify/threshold", None),
        ({"config": {"densify": {"target_points": 400}}}, "#/config/densify/target_points", None),
        ({"config": {"network": {"activation": "gelu"}}}, "#/config/network/activation", None),
        ({"config": {"preset": "paper"}}, "#/config/preset", None),
        ({"config": []}, "#/config", None),
        ({"metadata": {"a": 1}}, "#/metadata/a", None),
        ({"metadata": {"a": "x" * 600}}, "#/metadata/a", None),
        ({"scan_id": None}, "#/scan_id", None),
    ],
)
def test_wrong_values_are_pointed_at(
    body: dict[str, Any], pointer: str, code: str | None, client: httpx.Client, scan: dict[str, Any]
) -> None:
    answer = post_job(client, scan, **body)
    assert answer.status_code == 422, answer.text
    problem = answer.json()
    assert answer.headers["content-type"] == "application/problem+json"
    assert problem["code"] == "invalid_request"
    (error,) = problem["errors"]
    assert (error["pointer"], error["code"]) == (pointer, code or "invalid_value")
    assert len(error["message"]) > 10


def test_every_wrong_value_is_named_at_once(client: httpx.Client, scan: dict[str, Any]) -> None:
    config = {"extract": {"resolution": 100_000}, "densify": {"threshold": 5, "speed": 1}}
    problem = post_job(client, scan, config=config).json()
    assert {error["pointer"] for error in problem["errors"]} == {
        "#/config/extract/resolution",
        "#/config/densify/threshold",
        "#/config/densify/speed",
    }
    assert "16 to 1024" in problem["detail"]


def test_what_another_value_makes_right_is_not_blamed(
    client: httpx.Client, scan: dict[str, Any]
) -> None:
    config = {"network": {"skips": [4, 8], "film": [0], "layers": 12, "output": "tanh"}}
    problem = post_job(client, scan, preset="neural", config=config).json()
    (error,) = problem["errors"]
    assert error["pointer"] == "#/config/network/output"
    assert "abs" in error["message"]


def test_wrong_values_of_a_form_are_found_before_the_scan_is_read(client: httpx.Client) -> None:
    files = {"file": ("ball.npy", b"no cloud")}
    for form, pointer in (
        ({"preset": "best"}, "#/preset"),
        ({"config": "{"}, "#/config"),
        ({"config": '{"extract": {"resolution": 100000}}'}, "#/config/extract/resolution"),
        ({"speed": "fast"}, "#/speed"),
        ({"scan_id": "scan_x"}, "#/scan_id"),
    ):
        answer = client.post("/v1/jobs", data=form, files=files)
        assert answer.status_code == 422
        assert [error["pointer"] for error in answer.json()["errors"]] == [pointer]


@pytest.mark.parametrize("body", [b"", b"{", b'{"scan_id": NaN}', b"\xff\xfe", b"[" * 5000])
def test_what_is_no_json(body: bytes, client: httpx.Client) -> None:
    answer = client.post("/v1/jobs", content=body, headers={"content-type": "application/json"})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed_request")


def test_json_that_is_no_object(client: httpx.Client) -> None:
    assert client.post("/v1/jobs", json=[1, 2]).status_code == 422


def test_a_body_of_a_megabyte_is_no_job(client: httpx.Client) -> None:
    answer = client.post("/v1/jobs", content=b" " * (2 << 20))
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")


@pytest.mark.parametrize(
    "scan_id", ["nope", new_id("scan"), "../../etc"], ids=["nope", "new", "path"]
)
def test_a_job_needs_its_scan(scan_id: str, client: httpx.Client) -> None:
    answer = client.post("/v1/jobs", json={"scan_id": scan_id})
    assert (answer.status_code, answer.json()["code"]) == (404, "scan_not_found")
    assert answer.json()["errors"][0]["pointer"] == "#/scan_id"


def test_the_same_request_twice_is_one_job(client: httpx.Client, scan: dict[str, Any]) -> None:
    headers = {"idempotency-key": new_id("job")}
    body = {"scan_id": scan["id"]}
    first = client.post("/v1/jobs", json=body, headers=headers)
    again = client.post("/v1/jobs", json=body, headers=headers)
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"]
    assert "idempotency-replayed" not in first.headers
    assert again.headers["idempotency-replayed"] == "true"
    other = client.post("/v1/jobs", json=body | {"config": {"seed": 1}}, headers=headers)
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_conflict")
    long = client.post("/v1/jobs", json=body, headers={"idempotency-key": "x" * 300})
    assert long.json()["errors"][0]["pointer"] == "header:idempotency-key"


@pytest.mark.parametrize("part", ["", "/events", "/mesh", "/points", "/field", "/report"])
@pytest.mark.parametrize(
    "job_id", ["nope", new_id("job"), new_id("scan")], ids=["nope", "job", "scan"]
)
def test_unknown_jobs(job_id: str, part: str, client: httpx.Client) -> None:
    answer = client.get(f"/v1/jobs/{job_id}{part}")
    assert (answer.status_code, answer.json()["code"]) == (404, "job_not_found")


def test_unknown_jobs_cannot_be_stopped_or_asked(client: httpx.Client) -> None:
    for part in ("cancel", "udf"):
        answer = client.post(f"/v1/jobs/{new_id('job')}/{part}", json={"points": []})
        assert (answer.status_code, answer.json()["code"]) == (404, "job_not_found")


def test_deleted_jobs_are_gone(queued: str, client: httpx.Client, records: JobRecords) -> None:
    records.delete(queued, force=True)
    answer = client.get(f"/v1/jobs/{queued}")
    assert (answer.status_code, answer.json()["code"]) == (410, "gone")


def test_cancel_before_the_start(queued: str, client: httpx.Client) -> None:
    first = client.post(f"/v1/jobs/{queued}/cancel")
    again = client.post(f"/v1/jobs/{queued}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceled")
    assert (again.status_code, again.json()["state"]) == (202, "canceled")


def test_cancel_during_the_run(started: str, client: httpx.Client, records: JobRecords) -> None:
    first = client.post(f"/v1/jobs/{started}/cancel")
    again = client.post(f"/v1/jobs/{started}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceling")
    assert (again.status_code, again.json()["state"]) == (202, "canceling")
    records.finish(started, 1, JobState.SUCCEEDED)  # the worker was faster: the cancel still wins
    assert client.get(f"/v1/jobs/{started}").json()["state"] == "canceled"


def test_cancel_after_the_end(started: str, client: httpx.Client, records: JobRecords) -> None:
    records.finish(started, 1, JobState.SUCCEEDED)
    answer = client.post(f"/v1/jobs/{started}/cancel")
    assert answer.status_code == 409
    problem = answer.json()
    assert (problem["code"], problem["state"]) == ("job_finished", "succeeded")
    assert client.get(f"/v1/jobs/{started}").json()["state"] == "succeeded"


def test_nothing_changed_is_told_by_the_etag(
    queued: str, client: httpx.Client, records: JobRecords
) -> None:
    first = client.get(f"/v1/jobs/{queued}")
    headers = {"if-none-match": first.headers["etag"]}
    assert client.get(f"/v1/jobs/{queued}", headers=headers).status_code == 304
    records.request_cancel(queued)
    after = client.get(f"/v1/jobs/{queued}", headers=headers)
    assert (after.status_code, after.json()["state"]) == (200, "canceled")


def test_waiting_ends_with_the_job(started: str, client: httpx.Client, records: JobRecords) -> None:
    def work() -> None:
        time.sleep(0.3)
        records.update(started, 1, ("progress", {"progress": 0.5}), progress=0.5)
        time.sleep(0.3)
        records.finish(started, 1, JobState.SUCCEEDED)

    worker = threading.Thread(target=work)
    worker.start()
    began = time.monotonic()
    job = client.get(f"/v1/jobs/{started}", params={"wait": 20}).json()
    worker.join()
    assert job["state"] == "succeeded"
    assert 0.5 < time.monotonic() - began < 5


def test_waiting_for_any_change(started: str, client: httpx.Client, records: JobRecords) -> None:
    etag = client.get(f"/v1/jobs/{started}").headers["etag"]
    change = threading.Timer(
        0.3, lambda: records.update(started, 1, ("progress", {"progress": 0.5}), progress=0.5)
    )
    change.start()
    began = time.monotonic()
    headers = {"if-none-match": etag}
    answer = client.get(f"/v1/jobs/{started}", params={"wait": 20}, headers=headers)
    change.join()
    assert (answer.status_code, answer.json()["progress"]) == (200, 0.5)
    assert 0.2 < time.monotonic() - began < 5


def test_waiting_has_an_end(started: str, client: httpx.Client) -> None:
    began = time.monotonic()
    assert client.get(f"/v1/jobs/{started}", params={"wait": 0.5}).json()["state"] == "running"
    assert 0.4 < time.monotonic() - began < 5
    assert client.get(f"/v1/jobs/{started}", params={"wait": 1000}).status_code == 422


def test_jobs_are_listed_page_by_page(
    client: httpx.Client, records: JobRecords, store: FileStore
) -> None:
    scan = client.post("/v1/scans", content=ball(510)).json()
    made = [post_job(client, scan).json()["id"] for _ in range(5)]
    pages, cursor = [], None
    while True:
        query = {"scan_id": scan["id"], "limit": "2"} | ({"cursor": cursor} if cursor else {})
        page = client.get("/v1/jobs", params=query).json()
        pages.append([job["id"] for job in page["jobs"]])
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert [job_id for page in pages for job_id in page] == made[::-1]
    assert [len(page) for page in pages] == [2, 2, 1]


def test_jobs_are_listed_by_state(queued: str, client: httpx.Client, scan: dict[str, Any]) -> None:
    client.post(f"/v1/jobs/{queued}/cancel")
    query = {"scan_id": scan["id"], "state": "canceled"}
    found = client.get("/v1/jobs", params=query).json()["jobs"]
    assert queued in [job["id"] for job in found]
    assert {job["state"] for job in found} == {"canceled"}
    for bad in ({"state": "happy"}, {"limit": "0"}, {"cursor": "x"}, {"created_after": "then"}):
        answer = client.get("/v1/jobs", params=bad)
        assert answer.status_code == 422
        assert answer.json()["errors"][0]["pointer"] == f"?{next(iter(bad))}"


@pytest.mark.parametrize("part", ["mesh", "points", "field", "report"])
def test_an_unfinished_job_has_no_files(part: str, started: str, client: httpx.Client) -> None:
    answer = client.get(f"/v1/jobs/{started}/{part}")
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (409, "job_not_finished")
    assert problem["state"] == "running"


def test_a_failed_job_tells_why(started: str, client: httpx.Client, records: JobRecords) -> None:
    error = JobError("empty_surface", "there is no surface in the box")
    records.finish(started, 1, JobState.FAILED, error=error)
    answer = client.get(f"/v1/jobs/{started}/mesh")
    problem = answer.json()
    assert (answer.status_code, problem["code"], problem["state"]) == (409, "job_failed", "failed")
    assert problem["error"] == {"code": "empty_surface", "message": error.message}
    job = client.get(f"/v1/jobs/{started}").json()
    assert job["error"] == problem["error"]
    assert json.dumps(job["finished_at"]).endswith('Z"')
