"""Two API processes over one Redis and one folder: to a caller they are one service."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from jobs.events import Events
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.store import FileStore

SUBMISSIONS = 50


@pytest.fixture(scope="module")
def second(api: Api, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    log = tmp_path_factory.mktemp("second") / "log"
    with ApiProcess(api.shared, log, {}) as running:
        yield running


@pytest.fixture
def other(second: Api) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=second.url, timeout=30) as http:
        yield http


def _at_once(requests: int, *asked: Any) -> list[httpx.Response]:
    """The answers to requests that begin at the same moment, in turn by each of `asked`."""
    ready = threading.Barrier(requests)

    def one(number: int) -> httpx.Response:
        ready.wait(30)
        answer: httpx.Response = asked[number % len(asked)]()
        return answer

    with ThreadPoolExecutor(requests) as threads:
        return list(threads.map(one, range(requests)))


def test_equal_submissions_at_once_make_one_job(
    scan: dict[str, Any], api: Api, second: Api, records: JobRecords, store: FileStore
) -> None:
    body = {"scan_id": scan["id"], "metadata": {"run": new_id("job")}}
    headers = {"idempotency-key": new_id("job")}
    before = records.queue_length()

    def submit(url: str) -> httpx.Response:
        return httpx.post(f"{url}/v1/jobs", json=body, headers=headers, timeout=60)

    answers = _at_once(SUBMISSIONS, lambda: submit(api.url), lambda: submit(second.url))
    assert Counter(answer.status_code for answer in answers) == {202: SUBMISSIONS}
    (job_id,) = {answer.json()["id"] for answer in answers}
    assert {answer.headers["location"] for answer in answers} == {f"/v1/jobs/{job_id}"}
    told = Counter(answer.headers.get("idempotency-replayed") for answer in answers)
    assert told == {None: 1, "true": SUBMISSIONS - 1}
    assert records.queue_length() == before + 1
    kept = [folder.name for folder in (store.root / "jobs").iterdir()]
    assert kept.count(job_id) == 1
    written = [folder for folder in kept if records.get(folder) is None]
    assert written == []  # the losers took their manifests back


def test_equal_submissions_with_their_file_make_one_job(api: Api, second: Api) -> None:
    headers = {"idempotency-key": new_id("job")}
    file = ball(617)

    def submit(url: str) -> httpx.Response:
        files = {"file": ("ball.npy", file)}
        return httpx.post(f"{url}/v1/jobs", files=files, headers=headers, timeout=60)

    answers = _at_once(6, lambda: submit(api.url), lambda: submit(second.url))
    assert [answer.status_code for answer in answers] == [202] * 6
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert len({answer.json()["scan_id"] for answer in answers}) == 1


def test_both_answer_for_every_job(
    scan: dict[str, Any], client: httpx.Client, other: httpx.Client, records: JobRecords
) -> None:
    made = [http.post("/v1/jobs", json={"scan_id": scan["id"]}) for http in (client, other)]
    ids = [answer.json()["id"] for answer in made]
    for job_id in ids:
        own = f"/v1/jobs/{job_id}"
        assert client.get(own).json() == other.get(own).json()
        assert client.get(own).headers["etag"] == other.get(own).headers["etag"]
        assert client.get(f"{own}/events").json() == other.get(f"{own}/events").json()
    assert {*ids} <= {job["id"] for job in other.get("/v1/jobs?limit=200").json()["jobs"]}
    records.claim(ids[0], 1, "test")
    assert other.post(f"/v1/jobs/{ids[0]}/cancel").json()["state"] == "canceling"
    assert client.get(f"/v1/jobs/{ids[0]}").json()["state"] == "canceling"
    assert other.delete(f"/v1/jobs/{ids[0]}?force=true").status_code == 204
    assert client.get(f"/v1/jobs/{ids[0]}").json()["code"] == "gone"
    assert client.post(f"/v1/jobs/{ids[1]}/cancel").json()["state"] == "canceled"
    assert other.get(f"/v1/jobs/{ids[1]}").json()["state"] == "canceled"


def test_a_long_poll_at_one_hears_what_was_asked_at_the_other(
    started: str, client: httpx.Client, other: httpx.Client
) -> None:
    etag = client.get(f"/v1/jobs/{started}").headers["etag"]
    with ThreadPoolExecutor(1) as thread:
        waiting = thread.submit(
            lambda: other.get(f"/v1/jobs/{started}?wait=20", headers={"if-none-match": etag})
        )
        time.sleep(0.3)
        assert not waiting.done()
        client.post(f"/v1/jobs/{started}/cancel")
        assert waiting.result(10).json()["state"] == "canceling"


def _until_broken(url: str, messages: int) -> list[dict[str, Any]]:
    """The first messages of a websocket whose line is then cut, without a word of goodbye."""
    line = socket.create_connection((httpx.URL(url).host, httpx.URL(url).port))
    with connect(url, sock=line, max_queue=None, close_timeout=0.1) as watching:
        taken = [json.loads(watching.recv(timeout=10)) for _ in range(messages)]
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        line.shutdown(socket.SHUT_RDWR)
    return taken


def test_a_broken_line_goes_on_at_the_other_without_gap_or_repeat(
    started: str,
    api: Api,
    second: Api,
    at_work: AbstractContextManager[None],
    events: Events,
) -> None:
    seen: list[str] = []
    with at_work:
        for turn in range(10):
            server = (api, second)[turn % 2]
            url = f"{server.ws}/v1/jobs/{started}/events?after={seen[-1] if seen else '0-0'}"
            snapshot, *rest = _until_broken(url, 9)
            assert snapshot["type"] == "snapshot"
            seen += [message["id"] for message in rest]
    with connect(f"{api.ws}/v1/jobs/{started}/events?after={seen[-1]}", max_queue=None) as line:
        assert json.loads(line.recv(timeout=10))["type"] == "snapshot"
        with suppress(ConnectionClosed):
            while True:
                seen.append(json.loads(line.recv(timeout=10))["id"])
    assert line.close_code == 1000
    assert seen == [event.id for event in events.read(started, count=10_000)]
