"""Named keys: what each may do, see and how often."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobState
from service import keys
from service.callers import scope_needed

MAIN = "main-key-of-this-service"
Client = Callable[..., httpx.Client]


@pytest.fixture(scope="module")
def guarded(api_redis: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder = tmp_path_factory.mktemp("guarded")
    shared = Settings(data=folder / "data", redis_url=f"{api_redis.url}?db=4")
    environment = {"UDFLOW_KEY": MAIN, "UDFLOW_LOG": "json"}
    with ApiProcess(shared, folder / "log", environment) as running:
        yield running


@pytest.fixture
def add(
    guarded: Api, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Client]:
    """Makes a named key and gives a client that uses it."""
    monkeypatch.setenv("REDIS_URL", guarded.shared.url)
    opened: list[httpx.Client] = []
    names: list[str] = []

    def made(name: str, *options: str) -> httpx.Client:
        assert keys.main(["add", name, *options]) == 0
        names.append(name)
        token = capsys.readouterr().out.strip()
        headers = {"Authorization": f"Bearer {token}"}
        opened.append(httpx.Client(base_url=guarded.url, headers=headers, timeout=30))
        return opened[-1]

    yield made
    for client in opened:
        client.close()
    for name in names:
        keys.main(["remove", name])


@pytest.fixture
def main_client(guarded: Api) -> Iterator[httpx.Client]:
    headers = {"Authorization": f"Bearer {MAIN}"}
    with httpx.Client(base_url=guarded.url, headers=headers, timeout=30) as client:
        yield client


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def upload(client: httpx.Client, points: int = 500) -> str:
    answer = client.post("/v1/scans", files={"file": ("ball.npy", ball(points))})
    assert answer.status_code in (200, 201), answer.text
    return str(answer.json()["id"])


def start(client: httpx.Client, scan_id: str, **headers: str) -> httpx.Response:
    return client.post("/v1/jobs", json={"scan_id": scan_id}, headers=headers)


def test_a_key_is_shown_once_and_kept_hashed(add: Client, guarded: Api) -> None:
    client = add("hashed")
    token = client.headers["authorization"].removeprefix("Bearer ")
    assert token.startswith("udf_")
    assert len(token) > 40
    with guarded.shared.connect() as redis:
        stored = json.dumps(redis.hgetall(keys.KEYS))
    assert token not in stored
    assert keys.digest(token) in stored
    assert client.get("/v1/info").status_code == 200


@pytest.mark.parametrize(
    "arguments",
    [
        ["add", "bad name"],
        ["add", "x", "--scopes", "read,fly"],
        ["add", "x", "--rate", "often"],
        ["add", "twice"],
        ["remove", "nobody"],
    ],
)
def test_mistakes_are_explained(
    arguments: list[str], add: Client, capsys: pytest.CaptureFixture[str]
) -> None:
    add("twice")
    assert keys.main(arguments) == 1
    assert capsys.readouterr().err.startswith("udflow: error: ")


def test_keys_are_listed_and_removed(
    add: Client, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = add("shortlived")
    keys.main(["list"])
    assert '"shortlived"' in capsys.readouterr().out
    keys.main(["remove", "shortlived"])
    deadline = time.monotonic() + 8
    while client.get("/v1/info").status_code == 200 and time.monotonic() < deadline:
        time.sleep(0.2)
    assert code(client.get("/v1/info")) == (401, "unauthorized")
    keys.main(["add", "shortlived"])  # for the fixture to remove


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("GET", "/v1/jobs", "read"),
        ("HEAD", "/v1/jobs/x/mesh", "read"),
        ("POST", "/v1/jobs/x/udf", "read"),
        ("POST", "/v1/jobs/x/udf/slice", "read"),
        ("POST", "/v1/jobs", "write"),
        ("DELETE", "/v1/jobs/x", "write"),
        ("PATCH", "/v1/uploads/x", "write"),
        ("GET", "/metrics", "metrics"),
    ],
)
def test_the_right_that_is_needed(method: str, path: str, scope: str) -> None:
    assert scope_needed(method, path) == scope


def test_a_reader_may_not_write(add: Client) -> None:
    reader = add("reader", "--scopes", "read")
    assert reader.get("/v1/jobs").status_code == 200
    refused = reader.post("/v1/scans", files={"file": ("ball.npy", ball())})
    assert code(refused) == (403, "forbidden")
    assert refused.json()["needed"] == "write"
    assert code(reader.get("/metrics")) == (403, "forbidden")
    assert add("meter", "--scopes", "metrics").get("/metrics").status_code == 200


def test_everybody_sees_only_their_own(add: Client, main_client: httpx.Client) -> None:
    anna, ben = add("anna"), add("ben")
    scan = upload(anna)
    job = start(anna, scan).json()
    own = job["links"]["self"]
    for path in (own, f"{own}/events", f"{own}/mesh", f"{own}/deliveries"):
        assert code(ben.get(path)) == (404, "job_not_found")
        assert anna.get(path).status_code in (200, 409)
    assert code(ben.post(f"{own}/cancel")) == (404, "job_not_found")
    assert code(ben.delete(own)) == (404, "job_not_found")
    assert code(ben.get(f"/v1/scans/{scan}")) == (404, "scan_not_found")
    assert code(ben.delete(f"/v1/scans/{scan}")) == (404, "scan_not_found")
    assert code(start(ben, scan)) == (404, "scan_not_found")
    assert job["id"] not in [one["id"] for one in ben.get("/v1/jobs").json()["jobs"]]
    assert job["id"] in [one["id"] for one in anna.get("/v1/jobs").json()["jobs"]]
    assert job["id"] in [one["id"] for one in main_client.get("/v1/jobs").json()["jobs"]]
    assert main_client.get(own).status_code == 200
    assert upload(ben) != scan  # the same bytes, but nobody learns that another has them
    assert upload(anna) == scan


def test_uploads_are_private_too(add: Client) -> None:
    tus = {"Tus-Resumable": "1.0.0"}
    made = add("carla").post("/v1/uploads", headers=tus | {"Upload-Length": "10"})
    address = made.headers["location"]
    assert code(add("dora").get(address)) == (404, "upload_not_found")


def test_idempotency_keys_of_different_callers_do_not_meet(add: Client) -> None:
    erik, fred = add("erik"), add("fred")
    same = {"idempotency-key": "morning run"}
    first = start(erik, upload(erik), **same)
    second = start(fred, upload(fred), **same)
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json()["id"] != second.json()["id"]
    assert start(erik, upload(erik), **same).json()["id"] == first.json()["id"]


def test_a_rate_is_told_and_kept(add: Client) -> None:
    client = add("hasty", "--rate", "5/minute")
    answers = [client.get("/v1/info") for _ in range(7)]
    assert [answer.status_code for answer in answers] == [200] * 5 + [429] * 2
    assert answers[0].headers["ratelimit-policy"] == '"requests";q=5;w=60'
    assert answers[0].headers["ratelimit"].startswith('"requests";r=4;t=')
    assert code(answers[-1]) == (429, "rate_limited")
    assert 1 <= int(answers[-1].headers["retry-after"]) <= 60


def test_jobs_at_once(add: Client, guarded: Api) -> None:
    client = add("two-at-once", "--jobs", "2")
    scan = upload(client)
    first = start(client, scan).json()["id"]
    assert start(client, scan).status_code == 202
    refused = start(client, scan)
    assert code(refused) == (429, "too_many_jobs")
    assert "retry-after" in refused.headers
    with guarded.shared.connect() as redis:
        records = JobRecords(redis)
        records.claim(first, 1, "test")
        assert code(start(client, scan)) == (429, "too_many_jobs")
        records.finish(first, 1, JobState.SUCCEEDED)
    third = start(client, scan)
    assert third.status_code == 202
    client.post(f"/v1/jobs/{third.json()['id']}/cancel")
    assert start(client, scan).status_code == 202


def test_jobs_a_day(add: Client) -> None:
    client = add("thrifty", "--jobs-per-day", "1")
    scan, once = upload(client), {"idempotency-key": "the only one"}
    first = start(client, scan, **once)
    assert first.status_code == 202
    refused = start(client, scan)
    assert code(refused) == (429, "quota_exceeded")
    again = start(client, scan, **once)  # is no further job
    assert (again.status_code, again.json()["id"]) == (202, first.json()["id"])
    assert int(refused.headers["retry-after"]) > 60


def test_guessing_keys_is_slowed_down(guarded: Api, main_client: httpx.Client) -> None:
    wrong = {"Authorization": "Bearer guess"}
    answers = [httpx.get(f"{guarded.url}/v1/info", headers=wrong) for _ in range(70)]
    assert code(answers[0]) == (401, "unauthorized")
    assert code(answers[-1]) == (429, "rate_limited")
    assert main_client.get("/v1/info").status_code == 200


def test_a_websocket_opens_with_a_ticket_once(add: Client, guarded: Api) -> None:
    client = add("gina")
    job = start(client, upload(client)).json()
    address = guarded.ws + job["links"]["events"]
    ticket = client.post("/v1/tickets").json()
    assert ticket["expires_in_s"] == 30
    with connect(f"{address}?ticket={ticket['ticket']}") as socket:
        assert json.loads(socket.recv(10))["type"] == "snapshot"
    for used in (ticket["ticket"], "other"):
        with pytest.raises(InvalidStatus):
            connect(f"{address}?ticket={used}")
    stranger = add("hugo").post("/v1/tickets").json()["ticket"]
    with (
        connect(f"{address}?ticket={stranger}") as socket,
        pytest.raises(ConnectionClosedError, match="4404"),
    ):
        socket.recv(10)


def test_the_log_is_json_and_holds_no_key(add: Client, guarded: Api) -> None:
    client = add("ines")
    client.get("/v1/jobs?limit=3", headers={"x-request-id": "find-me"})
    token = client.headers["authorization"].removeprefix("Bearer ")
    text, deadline = "", time.monotonic() + 10.0
    while "find-me" not in text and time.monotonic() < deadline:
        text = Path(guarded.log).read_text()  # the answer may be here before its line
    lines = [json.loads(line) for line in text.splitlines()]
    (line,) = [line for line in lines if line.get("request_id") == "find-me"]
    assert (line["path"], line["status"], line["caller"]) == ("/v1/jobs", 200, "ines")
    assert line["ms"] >= 0
    assert token not in text
    assert MAIN not in text


def metric(text: str, name: str) -> dict[str, float]:
    rows = [line.rpartition(" ") for line in text.splitlines() if line.startswith(name)]
    return {labels: float(value) for labels, _, value in rows}


def test_figures_for_prometheus(main_client: httpx.Client, guarded: Api) -> None:
    def figures() -> str:
        return main_client.get("/metrics").text

    scan = upload(main_client)
    before: Any = metric(figures(), "udflow_jobs_waiting")["udflow_jobs_waiting"]
    job_id = start(main_client, scan).json()["id"]
    assert metric(figures(), "udflow_jobs_waiting")["udflow_jobs_waiting"] == before + 1
    assert metric(figures(), "udflow_oldest_wait_seconds")["udflow_oldest_wait_seconds"] > 0
    main_client.post(f"/v1/jobs/{job_id}/cancel")
    text = figures()
    canceled = 'udflow_jobs_total{state="canceled"}'
    assert metric(text, canceled)[canceled] >= 1
    created = 'udflow_requests_total{method="POST",route="/v1/jobs",status="202"}'
    assert metric(text, created)[created] >= 1
    buckets = metric(text, 'udflow_request_seconds_bucket{route="/v1/jobs"')
    assert list(buckets.values()) == sorted(buckets.values())
    count = 'udflow_request_seconds_count{route="/v1/jobs"}'
    assert metric(text, count)[count] == list(buckets.values())[-1]
    for line in text.splitlines():
        assert line.startswith(("# HELP udflow_", "# TYPE udflow_", "udflow_")), line
