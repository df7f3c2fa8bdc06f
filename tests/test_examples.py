"""The examples run as their readers would run them."""

from __future__ import annotations

import io
import json
import os
import re
import secrets
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from shapes import Sphere
from whole_service import running

from udflow.client import Client
from udflow.mesh.load import read_mesh

ROOT = Path(__file__).resolve().parent.parent
KEY = secrets.token_hex(16)
QUICK = {"densify": {"target_points": 0}, "extract": {"resolution": 32}}


def example(name: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), *arguments]
    return subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


def test_every_example_is_run_here() -> None:
    names = {path.stem for path in (ROOT / "examples").glob("*.py")}
    assert names == {"reconstruct_in_memory", "http_client", "watch_job", "robot_path"}


def test_reconstruct_in_memory(tmp_path: Path) -> None:
    done = example("reconstruct_in_memory", str(tmp_path / "torus.glb"))
    assert done.returncode == 0, done.stderr
    assert "100% exporting" in done.stdout
    inside = re.search(r"inside: ([\d.]+)", done.stdout)
    above = re.search(r"above the top: +([\d.]+)", done.stdout)
    assert inside is not None
    assert above is not None
    assert float(inside[1]) == pytest.approx(0.4, abs=0.03)
    assert float(above[1]) == pytest.approx(0.5, abs=0.03)
    assert len(read_mesh(tmp_path / "torus.glb").faces) > 1_000


@pytest.fixture(scope="module")
def guarded_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a whole running service that asks for a key."""
    with running(tmp_path_factory.mktemp("guarded") / "data", UDFLOW_KEY=KEY) as url:
        yield url


def test_http_client(guarded_service: str, tmp_path: Path) -> None:
    scan, mesh = tmp_path / "scan.npy", tmp_path / "mesh.ply"
    np.save(scan, Sphere().sample(1_500).numpy())
    arguments = [str(scan), str(mesh), "--url", guarded_service, "--config", json.dumps(QUICK)]
    done = example("http_client", *arguments, UDFLOW_KEY=KEY)
    assert done.returncode == 0, done.stderr
    assert "extracting" in done.stdout
    distance = re.search(r"the origin is ([\d.]+) from the surface", done.stdout)
    assert distance is not None
    assert float(distance[1]) == pytest.approx(0.5, abs=0.02)
    radius = np.linalg.norm(read_mesh(mesh).vertices, axis=1)
    np.testing.assert_allclose(radius, 0.5, atol=0.02)


def test_http_client_says_why_a_scan_is_refused(guarded_service: str, tmp_path: Path) -> None:
    scan = tmp_path / "scan.ply"
    scan.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 9\n")
    arguments = [str(scan), str(tmp_path / "mesh.ply"), "--url", guarded_service]
    done = example("http_client", *arguments, UDFLOW_KEY=KEY)
    assert done.returncode == 1
    assert done.stderr.startswith("refused: ")
    done = example("http_client", *arguments, UDFLOW_KEY="wrong")
    assert "Authorization: Bearer" in done.stderr


@pytest.fixture(scope="module")
def remote_job(guarded_service: str) -> str:
    """The id of a finished job: a sphere of radius 0.5."""
    with Client(guarded_service, KEY) as service:
        scan = io.BytesIO()
        np.save(scan, Sphere().sample(1_500).numpy())
        job = service.submit(scan.getvalue(), config=QUICK)
        return str(service.wait(job["id"])["id"])


def test_watch_job(guarded_service: str, remote_job: str) -> None:
    done = example("watch_job", remote_job, "--url", guarded_service, UDFLOW_KEY=KEY)
    assert done.returncode == 0, done.stderr
    assert "succeeded" in done.stdout
    assert done.stdout.count("fitting") >= 1


def test_robot_path(guarded_service: str, remote_job: str) -> None:
    done = example("robot_path", remote_job, "--url", guarded_service, UDFLOW_KEY=KEY)
    assert done.returncode == 0, done.stderr
    closest = re.search(r"closest approach: ([\d.]+)", done.stdout)
    assert closest is not None
    assert float(closest[1]) == pytest.approx(0.25, abs=0.02)


def test_curl(guarded_service: str, tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", Sphere().sample(1_500).numpy())
    environment = {"UDFLOW_URL": guarded_service, "UDFLOW_KEY": KEY, "CONFIG": json.dumps(QUICK)}
    command = ["sh", str(ROOT / "examples" / "with_curl.sh"), "scan.npy", "mesh.glb"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(read_mesh(tmp_path / "mesh.glb").faces) > 500
    assert '"distance": [0.50' in done.stdout
