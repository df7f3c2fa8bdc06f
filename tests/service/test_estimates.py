"""`validate_only`: what a job would take. Jobs that are too much are refused before they wait."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import redis
from api_process import ball

from jobs import keys
from jobs.costs import Costs, Sample, Workload
from jobs.records import JobRecords
from udflow.config import from_dict, to_dict


@pytest.fixture
def small_machine(redis_client: redis.Redis, scan: dict[str, Any]) -> Iterator[float]:
    """A machine on which jobs have run with 600 MB. Gives the bytes."""
    memory = 600.0 * 2**20
    workload = Workload.of(scan, to_dict(from_dict({})), "reconstruct")
    for _ in range(5):
        taken = Sample(workload, "cpu", workload.seconds(), workload.memory(), memory)
        Costs(redis_client).remember(taken)
    yield memory
    redis_client.delete(keys.costs("fast", "reconstruct"))


def ask(client: httpx.Client, scan: dict[str, Any], **config: Any) -> httpx.Response:
    body = {"scan_id": scan["id"], "config": config}
    return client.post("/v1/jobs?validate_only=true", json=body)


def test_an_estimate_queues_nothing(
    client: httpx.Client, scan: dict[str, Any], records: JobRecords
) -> None:
    waiting = records.queue_length()
    answer = ask(client, scan, extract={"resolution": 64})
    assert answer.status_code == 200, answer.text
    told = answer.json()
    assert (told["valid"], told["scan_id"]) == (True, scan["id"])
    assert told["config"]["extract"]["resolution"] == 64
    for name in ("seconds", "memory_bytes"):
        found = told["estimate"][name]
        assert 0 < found["low"] < found["expected"] < found["high"]
    assert told["estimate"]["jobs"] == 0
    assert "reference" in told["estimate"]["basis"]
    assert records.queue_length() == waiting == told["jobs_ahead"]


def test_a_file_can_be_estimated_in_one_go(client: httpx.Client) -> None:
    answer = client.post("/v1/jobs?validate_only=1", files={"file": ("ball.npy", ball())})
    assert answer.status_code == 200, answer.text
    assert client.get(f"/v1/scans/{answer.json()['scan_id']}").status_code == 200


def test_wrong_parameters_are_told_as_ever(client: httpx.Client, scan: dict[str, Any]) -> None:
    answer = ask(client, scan, extract={"resolution": 1})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


def test_more_than_the_machine_has_is_refused(
    small_machine: float, client: httpx.Client, scan: dict[str, Any], records: JobRecords
) -> None:
    waiting = records.queue_length()
    body = {"scan_id": scan["id"], "config": {"extract": {"resolution": 1024}}}
    for address in ("/v1/jobs", "/v1/jobs?validate_only=true"):
        answer = client.post(address, json=body)
        problem = answer.json()
        assert (answer.status_code, problem["code"]) == (422, "job_too_costly"), problem
    assert records.queue_length() == waiting
    assert problem["errors"][0]["pointer"] == "#/config/extract/resolution"
    assert problem["estimate"]["memory_bytes"]["low"] > small_machine
    assert str(problem["largest"]) in problem["detail"]
    affordable = ask(client, scan, extract={"resolution": problem["largest"]})
    assert affordable.status_code == 200
    assert affordable.json()["estimate"]["jobs"] == 5


def test_training_beyond_the_longest_run_is_refused_where_it_is_asked_for(
    client: httpx.Client, scan: dict[str, Any]
) -> None:
    body = {"scan_id": scan["id"], "preset": "paper"}
    modest = client.post("/v1/jobs?validate_only=true", json=body).json()["estimate"]
    assert modest["seconds"]["expected"] > 3600
    assert modest["seconds"]["low"] < modest["seconds"]["expected"] < modest["seconds"]["high"]
    assert "reference machine" in modest["basis"]
    endless = body | {"config": {"training": {"iterations": 10_000_000}}}
    problem = client.post("/v1/jobs", json=endless).json()
    assert (problem["code"], problem["largest"]) == ("job_too_costly", None)
    assert problem["errors"][0]["pointer"] == "#/config/training/iterations"
