"""Callers that trickle, stall or come too late: the others do not notice."""

from __future__ import annotations

import socket
import statistics
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from chaos_kit import say

from jobs.records import JobRecords
from jobs.spec import JobSpec, JobState

TRICKLING = 200


@pytest.fixture(scope="module")
def api(lasting: Any) -> Iterator[Api]:
    limits = {"UDFLOW_BODY_TIMEOUT_S": "2"}
    log = lasting.faults.folder.parent / "api.log"
    with ApiProcess(lasting.shop.settings, log, limits) as running:
        yield running


def test_two_hundred_who_trickle_do_not_keep_others_waiting(api: Api) -> None:
    host, _, port = api.url.removeprefix("http://").partition(":")
    with httpx.Client(base_url=api.url, timeout=30) as client:
        alone = statistics.median(asked(client) for _ in range(30))
        lines = [socket.create_connection((host, int(port))) for _ in range(TRICKLING)]
        heads = b"POST /v1/scans HTTP/1.1\r\nHost: " + f"{host}:{port}".encode() + b"\r\n"
        for number, line in enumerate(lines):
            line.sendall(heads if number % 2 else heads + b"Content-Length: 1000\r\n\r\n")
        took = []
        for number in range(60):
            for line in lines[number % 10 :: 10]:
                line.sendall(b"X" if number < 5 else b"")
            took.append(asked(client))
        scan = client.post("/v1/scans", content=ball())
    assert scan.status_code == 201
    assert max(took) < 1.0
    say(
        f"{TRICKLING} trickling connections: median answer {statistics.median(took) * 1e3:.1f} ms, "
        f"alone {alone * 1e3:.1f} ms"
    )
    time.sleep(2.5)
    answered = [line.recv(100)[:12] for line in lines[0::2]]  # those whose body stopped arriving
    assert set(answered) == {b"HTTP/1.1 408"}
    for line in lines:
        line.close()


def asked(client: httpx.Client) -> float:
    began = time.perf_counter()
    assert client.get("/v1/jobs").status_code == 200
    return time.perf_counter() - began


def test_a_download_under_way_outlives_its_job(lasting: Any, api: Api) -> None:
    shop, content = lasting.shop, bytes(range(256)) * (40 << 12)  # 40 MB, more than lies on the way
    records: JobRecords = shop.records
    scan = httpx.post(f"{api.url}/v1/scans", content=ball(), timeout=30).json()["id"]
    spec = JobSpec.new(scan, {}, ttl_s=1e-3)
    shop.store.write_job(spec)
    records.create(spec)
    records.claim(spec.id, 1)
    mesh = shop.store.put_artifact(spec.id, 1, "mesh.ply", lambda path: path.write_bytes(content))
    records.finish(spec.id, 1, JobState.SUCCEEDED, outputs={"mesh.ply": mesh})
    address = f"{api.url}/v1/jobs/{spec.id}/mesh"
    with httpx.stream("GET", address, timeout=30) as answer:
        pieces = answer.iter_raw(1 << 16)
        received = [next(pieces)]
        time.sleep(0.01)
        shop.reaper.sweep()  # its time is over
        assert records.get(spec.id) is None
        assert not shop.store.artifact_path(mesh).exists()
        received += pieces
    assert b"".join(received) == content
    assert httpx.get(address).status_code == 410
