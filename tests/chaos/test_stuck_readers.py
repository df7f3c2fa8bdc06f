"""Fifty who listen to a job and never read, beside one who does."""

from __future__ import annotations

import base64
import json
import os
import socket
import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from chaos_kit import in_background, memory_of, say, soak_only
from websockets.sync.client import connect

from jobs.records import JobRecords
from jobs.spec import JobSpec

STUCK = 50
GONE_S = 15.0
PERIOD_S = 0.03
PADDING = "x" * 6000  # so that what lies between the ends is soon full
MEMORY = 48 << 20  # fifty full queues, and what Python keeps of them


@pytest.fixture
def api(ground: Any) -> Iterator[Api]:
    with ApiProcess(ground.shop.settings, ground.faults.folder.parent / "api.log", {}) as running:
        yield running


@pytest.fixture
def job(ground: Any, api: Api) -> str:
    """A running job; the test is its worker."""
    records = ground.shop.records
    scan = httpx.post(f"{api.url}/v1/scans", content=ball(), timeout=30).json()["id"]
    spec = JobSpec.new(scan, {})
    records.create(spec)
    assert records.claim(spec.id, 1, "test") is not None
    return spec.id


@soak_only
def test_fifty_who_never_read_harm_nobody(ground: Any, api: Api, job: str) -> None:
    server = pid_behind(api.url)
    with (
        connect(f"{api.ws}/v1/jobs/{job}/events") as live,
        in_background(lambda over: speak(ground.shop.settings.connect(), job, over)),
    ):
        live.recv(10)
        alone = latencies(live, 60)
        memory, sockets = memory_of(server), established(api.url)
        stuck = [never_reading(api.url, job) for _ in range(STUCK)]
        assert established(api.url) >= sockets + STUCK
        began, beside, most = time.monotonic(), [], 0
        while established(api.url) > sockets:
            beside += latencies(live, 10)
            most = max(most, memory_of(server))
            assert time.monotonic() - began < GONE_S + 10.0, "they are still there"
        gone_s = time.monotonic() - began
        afterwards = latencies(live, 60)
    for one in stuck:
        one.close()
    figures = [statistics.median(found) for found in (alone, beside, afterwards)]
    say(
        f"{STUCK} stuck readers: gone after {gone_s:.1f} s, memory +{(most - memory) >> 20} MB, "
        f"median latency alone {figures[0] * 1e3:.1f} ms, beside them {figures[1] * 1e3:.1f} ms"
    )
    assert gone_s < GONE_S
    assert most - memory < MEMORY
    assert figures[1] < max(3 * figures[0], 0.1)


def speak(connection: Any, job_id: str, over: threading.Event) -> None:
    """Progress with the time at which it was said."""
    records = JobRecords(connection)
    while not over.wait(PERIOD_S):
        data = {"said": time.time(), "padding": PADDING}
        assert records.update(job_id, 1, ("warning", data))
    connection.close()


def latencies(live: Any, count: int) -> list[float]:
    """Seconds from Redis to the reader, of the next events; the oldest ones are old."""
    found = []
    while len(found) < count:
        message = json.loads(live.recv(10))
        if "said" in message["data"]:
            found.append(time.time() - message["data"]["said"])
    return found


def never_reading(url: str, job_id: str) -> socket.socket:
    """A websocket that was opened and is never read from."""
    host, _, port = url.removeprefix("http://").partition(":")
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect((host, int(port)))
    key = base64.b64encode(os.urandom(16)).decode()
    request = [
        f"GET /v1/jobs/{job_id}/events HTTP/1.1",
        f"Host: {host}:{port}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
    ]
    line.sendall("\r\n".join([*request, "", ""]).encode())
    assert line.recv(12) == b"HTTP/1.1 101"
    return line


def established(url: str) -> int:
    """Connections that the server holds."""
    port = int(url.rpartition(":")[2])
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(row[1].endswith(f":{port:04X}") and row[3] == "01" for row in rows)


def pid_behind(url: str) -> int:
    """Of the process that listens there."""
    port = int(url.rpartition(":")[2])
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    (inode,) = [row[9] for row in rows if row[1].endswith(f":{port:04X}") and row[3] == "0A"]
    for path in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(path) == f"socket:[{inode}]":
                return int(path.parts[2])
        except OSError:
            continue
    raise AssertionError("nobody listens")
