"""Webhooks that a real receiver gets, refuses, or never answers."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from workshop import Workshop

from jobs import keys
from jobs.ids import new_id
from jobs.spec import JobError, JobSpec, JobState
from jobs.webhooks import WebhookQueue, secret_of, verify
from worker.webhooks import NotSent, Sender, post

SECRET = "whsec_" + "QUJD" * 10


@dataclass
class Receiver:
    url: str
    status: int = 204
    got: list[tuple[dict[str, str], bytes]] = field(default_factory=list)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            found.got.append(({k.lower(): v for k, v in self.headers.items()}, body))
            self.send_response(found.status)
            self.send_header("Location", "/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    found = Receiver(f"http://127.0.0.1:{server.server_address[1]}/hook?x=1")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield found
    server.shutdown()
    server.server_close()


@pytest.fixture
def sender(own_shop: Workshop) -> Iterator[Sender]:
    settings = replace(
        own_shop.settings, webhook_secret=SECRET, webhook_hosts=("127.0.0.1", "localhost")
    )
    found = Sender(settings)
    yield found
    found.close()


def job(shop: Workshop, url: str) -> str:
    spec = JobSpec.new(new_id("scan"), {}, {"room": "hall"}, webhook=url)
    shop.records.create(spec)
    return spec.id


def test_starts_and_ends_are_told_and_signed(
    own_shop: Workshop, sender: Sender, receiver: Receiver
) -> None:
    job_id = job(own_shop, receiver.url)
    assert sender.sweep() == 0
    own_shop.records.claim(job_id, 1, "test")
    sender.sweep()
    own_shop.records.finish(job_id, 1, JobState.FAILED, error=JobError("diverged", "too much"))
    sender.sweep()
    told = [json.loads(body) for _, body in receiver.got]
    assert [one["type"] for one in told] == ["job.started", "job.failed"]
    assert told[0]["data"]["error"] is None
    assert told[1]["data"] | {"attempt": 1} == {
        "id": job_id,
        "kind": "reconstruct",
        "scan_id": own_shop.get(job_id).scan_id,
        "state": "failed",
        "attempt": 1,
        "metadata": {"room": "hall"},
        "error": {"code": "diverged", "message": "too much"},
        "url": f"/v1/jobs/{job_id}",
    }
    for headers, body in receiver.got:
        assert verify(secret_of(SECRET), headers, body)
        assert abs(time.time() - int(headers["webhook-timestamp"])) < 60
    assert len({headers["webhook-id"] for headers, _ in receiver.got}) == 2
    assert own_shop.connection.zcard(keys.WEBHOOKS) == 0
    assert sender.sweep() == 0


def test_what_is_refused_comes_again_later(
    own_shop: Workshop, sender: Sender, receiver: Receiver
) -> None:
    receiver.status = 503
    job_id = job(own_shop, receiver.url)
    own_shop.records.claim(job_id, 1, "test")
    sender.sweep()
    assert sender.sweep() == 0
    queue = WebhookQueue(own_shop.connection)
    (first,) = queue.deliveries(job_id)
    assert (first.status, first.attempt, first.error) == (503, 1, None)
    assert first.next_at is not None
    assert 4 < first.next_at - first.time < 7
    own_shop.connection.zadd(keys.WEBHOOKS, {f"{job_id}:running": 0})
    receiver.status = 200
    sender.sweep()
    last, _ = queue.deliveries(job_id)
    assert (last.status, last.attempt, last.next_at) == (200, 2, None)
    assert receiver.got[0][0]["webhook-id"] == receiver.got[1][0]["webhook-id"]


@pytest.mark.parametrize("status", [302, 410])
def test_redirects_are_not_followed_and_gone_is_final(
    status: int, own_shop: Workshop, sender: Sender, receiver: Receiver
) -> None:
    receiver.status = status
    job_id = job(own_shop, receiver.url)
    own_shop.records.claim(job_id, 1, "test")
    sender.sweep()
    assert len(receiver.got) == 1
    (only,) = WebhookQueue(own_shop.connection).deliveries(job_id)
    assert only.status == status
    assert (only.next_at is None) == (status == 410)


def test_nobody_listens(own_shop: Workshop, sender: Sender) -> None:
    job_id = job(own_shop, "http://127.0.0.1:9/hook")
    own_shop.records.claim(job_id, 1, "test")
    sender.sweep()
    (only,) = WebhookQueue(own_shop.connection).deliveries(job_id)
    assert (only.status, "refused" in (only.error or "")) == (None, True)


@pytest.mark.parametrize(
    "url", ["https://localhost/", "https://127.0.0.1:8443/", "https://[::1]/", "http://8.8.8.8/"]
)
def test_addresses_inside_are_never_called(url: str) -> None:
    with pytest.raises(NotSent):
        post(url, b"{}", {}, ())


def test_a_deleted_job_tells_nothing(
    own_shop: Workshop, sender: Sender, receiver: Receiver
) -> None:
    job_id = job(own_shop, receiver.url)
    own_shop.records.claim(job_id, 1, "test")
    own_shop.records.delete(job_id, force=True)
    sender.sweep()
    assert receiver.got == []
    assert own_shop.connection.zcard(keys.WEBHOOKS) == 0


def test_two_senders_send_once(own_shop: Workshop, sender: Sender, receiver: Receiver) -> None:
    for _ in range(20):
        own_shop.records.claim(job(own_shop, receiver.url), 1, "test")
    threads = [threading.Thread(target=sender.sweep) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    sender.sweep()
    assert len(receiver.got) == len({headers["webhook-id"] for headers, _ in receiver.got}) == 20
