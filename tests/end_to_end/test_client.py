"""The Python client and the commands built on it, also over a line that keeps breaking."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from api_process import npy
from user_steps import RADIUS, SMALL, Finished, sphere

from udflow.cli import main
from udflow.client import Client, JobEnded, ServiceAway, ServiceError
from udflow.mesh.load import read_mesh


@pytest.fixture
def service(url: str) -> Iterator[Client]:
    with Client(url) as client:
        yield client


@dataclass
class BreakingLine:
    """Passes bytes on, and hangs up on each of the first connections after some of them."""

    url: str
    breaks: int
    after: int = 20_000
    connections: int = 0


@pytest.fixture
def breaking(url: str) -> Iterator[Any]:
    server = socket.create_server(("127.0.0.1", 0))
    target = httpx.URL(url)
    ends: list[socket.socket] = []
    line = BreakingLine(f"http://127.0.0.1:{server.getsockname()[1]}", breaks=0)

    def copy(source: socket.socket, sink: socket.socket, allowed: int) -> None:
        with suppress(OSError):
            while allowed > 0 and (data := source.recv(min(allowed, 65536))):
                sink.sendall(data)
                allowed -= len(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def serve() -> None:
        with suppress(OSError):
            while True:
                near, _ = server.accept()
                far = socket.create_connection((target.host, target.port or 80))
                line.connections += 1
                ends.extend((near, far))
                allowed = line.after if line.connections <= line.breaks else 1 << 40
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=copy, args=(source, sink, allowed), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    yield line
    server.shutdown(socket.SHUT_RDWR)
    server.close()
    for end in ends:
        end.close()


def test_scan_in_mesh_out(service: Client, tmp_path: Path) -> None:
    scan = tmp_path / "hall ä.npy"
    scan.write_bytes(npy(sphere(1200)))
    told: list[dict[str, Any]] = []
    assert service.estimate(scan, config=SMALL)["seconds"]["expected"] > 0
    job = service.submit(scan, config=SMALL, metadata={"room": "hall"})
    done = service.wait(job["id"], progress=told.append)
    assert (done["state"], done["metadata"]) == ("succeeded", {"room": "hall"})
    assert told[-1]["state"] == "succeeded"
    for name in ("mesh.glb", "mesh.ply"):
        mesh = read_mesh(service.mesh(job["id"], tmp_path / name))
        np.testing.assert_allclose(
            np.linalg.norm(mesh.vertices, axis=1), RADIUS, atol=0.02 * RADIUS
        )
    answer = service.query(job["id"], [[0, 0, 2 * RADIUS]], gradients=True, closest=True)
    assert answer.distance[0] == pytest.approx(RADIUS, rel=0.02)
    assert answer.gradient is not None
    np.testing.assert_allclose(answer.gradient[0], [0, 0, 1], atol=0.05)
    assert answer.closest is not None
    assert answer.closest[0, 2] == pytest.approx(RADIUS, rel=0.02)
    assert job["id"] in [one["id"] for one in service.jobs(state="succeeded")]
    finer = service.extract(job["id"], resolution=64)
    assert service.wait(finer["id"])["source"] == job["id"]
    service.delete(finer["id"])
    with pytest.raises(ServiceError, match="deleted") as gone:
        service.job(finer["id"])
    assert (gone.value.code, gone.value.status) == ("gone", 410)


def test_a_line_that_keeps_breaking(
    breaking: BreakingLine, finished: Finished, tmp_path: Path
) -> None:
    points = np.random.default_rng(5).normal(size=(5000, 3))
    breaking.breaks = 3
    with Client(breaking.url) as client:
        scan = client.upload(npy(points))
        assert scan["points"] == 5000
    breaking.breaks = breaking.connections + 3
    with Client(breaking.url) as client:
        path = client.mesh(finished.id, tmp_path / "mesh.obj")
    assert path.stat().st_size == finished.job["outputs"]["mesh.obj"]["bytes"] > 100_000
    assert [file.name for file in tmp_path.iterdir()] == ["mesh.obj"]


def test_no_event_is_lost_or_repeated_when_the_line_breaks(
    breaking: BreakingLine, service: Client
) -> None:
    job = service.submit(npy(sphere(900)), config=SMALL)
    breaking.breaks, breaking.after = 2, 2_500
    with Client(breaking.url) as client:
        told = list(client.events(job["id"], "0-0"))
    assert breaking.connections > 2
    page = service._json("GET", f"/v1/jobs/{job['id']}/events", params={"limit": 1000})
    states = [e["id"] for e in page["events"] if e["type"] != "progress"]
    assert [e["id"] for e in told if e["type"] not in ("progress", "snapshot")] == states
    ids = [e["id"] for e in told if e["type"] != "snapshot"]
    assert len(set(ids)) == len(ids)
    assert [e["type"] for e in service.events(job["id"], told[-1]["id"])] == ["snapshot"]


def test_a_job_that_ends_without_a_result(service: Client) -> None:
    flat = np.random.default_rng(1).normal(size=(500, 3))
    long = SMALL | {"extract": {"resolution": 512}}
    job = service.submit(npy(flat), config=long)
    assert service.cancel(job["id"])["state"] in ("canceling", "canceled")
    with pytest.raises(JobEnded, match="canceled"):
        service.wait(job["id"])
    again = service.retry(job["id"])
    assert again["retried_from"] == job["id"]
    service.cancel(again["id"])


def test_refusals_are_errors_with_codes(service: Client) -> None:
    with pytest.raises(ServiceError) as refused:
        service.submit(npy(sphere(500)), config={"extract": {"resolution": 1}})
    assert (refused.value.code, refused.value.status) == ("invalid_request", 422)
    assert refused.value.problem["errors"][0]["pointer"] == "#/config/extract/resolution"
    with pytest.raises(ServiceError) as bad:
        service.upload(b"%PDF-1.4 no cloud")
    assert bad.value.code == "unknown_format"


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("udflow.client._PAUSE_S", 0.001)
    with Client("http://127.0.0.1:9") as client, pytest.raises(ServiceAway):
        client.job("job_x")


def test_torch_stays_away() -> None:
    code = "import sys, udflow.client; raise SystemExit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_commands(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan, mesh = tmp_path / "scan.npy", tmp_path / "mesh.glb"
    scan.write_bytes(npy(sphere(1200)))
    options = ["--url", url]
    small = ["--resolution", "32", "--set", "densify.target_points=0"]
    assert main(["submit", str(scan), "--estimate", *small, *options]) == 0
    assert json.loads(capsys.readouterr().out)["memory_bytes"]["high"] > 0
    assert main(["submit", str(scan), *small, *options]) == 0
    job_id = capsys.readouterr().out.strip()
    assert main(["watch", job_id, "--json", "--after", "0-0", *options]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert events[-1]["data"]["state"] == "succeeded"
    assert main(["fetch", job_id, "-o", str(mesh), *options]) == 0
    np.testing.assert_allclose(
        np.linalg.norm(read_mesh(mesh).vertices, axis=1), RADIUS, atol=0.02 * RADIUS
    )
    assert main(["fetch", job_id, "-o", str(mesh), *options]) == 2  # it is there already
    points, answers = tmp_path / "points.npy", tmp_path / "answers.npy"
    np.save(points, np.zeros((3, 3)))
    assert main(["query", job_id, str(points), "-o", str(answers), *options]) == 0
    np.testing.assert_allclose(np.load(answers), RADIUS, rtol=0.05)
    capsys.readouterr()
    assert main(["watch", "job_unknown", *options]) == 4
    assert "udflow: error: the server refused" in capsys.readouterr().err


def test_submit_waits_and_fetches(url: str, tmp_path: Path) -> None:
    scan, mesh = tmp_path / "scan.npy", tmp_path / "mesh.stl"
    scan.write_bytes(npy(sphere(1000)))
    small = ["--resolution", "24", "--set", "densify.target_points=0", "--quiet"]
    assert main(["submit", str(scan), "-o", str(mesh), "--url", url, *small]) == 0
    assert len(read_mesh(mesh).faces) > 500
