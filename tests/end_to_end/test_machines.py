"""Two APIs and two workers that share a Redis and a bucket, and no folder."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import httpx
import numpy as np
import pytest
import trimesh
from api_process import ROOT, Api, ApiProcess, npy
from s3_server import S3Server
from user_steps import RADIUS, sphere, submit, wait

from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from udflow.client import Client

PLAIN = {"target_points": 0}


@dataclass(frozen=True)
class Site:
    apis: tuple[Api, Api]
    bucket: S3Server
    folders: tuple[Path, ...]


@pytest.fixture(scope="module")
def site(redis_server: EmbeddedRedis, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    base = tmp_path_factory.mktemp("machines")
    url = f"{redis_server.url}?db=7"
    with ExitStack() as held:
        bucket = held.enter_context(S3Server(base / "s3"))
        shared = bucket.environment | {"STORE_URL": "s3://bucket/site"}
        apis = [
            held.enter_context(
                ApiProcess(
                    Settings(data=base / name / "data", redis_url=url), base / f"{name}.log", shared
                )
            )
            for name in ("api1", "api2")
        ]
        for name in ("worker1", "worker2"):
            held.callback(_end, _worker(base / name, url, shared))
        yield Site((apis[0], apis[1]), bucket, tuple(base / f"worker{i}" for i in (1, 2)))


def _worker(folder: Path, url: str, shared: dict[str, str]) -> subprocess.Popen[bytes]:
    folder.mkdir()
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "LANG") if name in os.environ}
    known = {"REDIS_URL": url, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "worker"],
            cwd=folder,  # its data folder comes to lie here
            env=kept | known | shared,
            stdout=log,
            stderr=log,
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.wait(20)


def test_any_api_answers_for_any_job(site: Site) -> None:
    first, second = (httpx.Client(base_url=api.url, timeout=70) for api in site.apis)
    with first, second:
        jobs = [submit(first, sphere(1000, seed), densify=PLAIN) for seed in (1, 2)]
        for job_id in jobs:
            job = wait(second, job_id)
            assert job["state"] == "succeeded", job
            assert first.get(f"/v1/jobs/{job_id}").json() == second.get(f"/v1/jobs/{job_id}").json()
            for client in (first, second):
                points = {"points": [[0, 0, 2 * RADIUS]]}
                told = client.post(f"/v1/jobs/{job_id}/udf", json=points).json()
                assert told["distance"][0] == pytest.approx(RADIUS, rel=0.03)
        scan = second.get(f"/v1/jobs/{jobs[0]}").json()["links"]["scan"]
        assert first.get(scan).json() == second.get(scan).json()
        again = second.post("/v1/scans", content=npy(sphere(1000, 1)))
        assert (again.status_code, again.headers["location"]) == (200, scan)
    for folder in site.folders:  # nothing was handed over by a folder
        assert not (folder / ".udflow" / "secret.key").exists()


def test_downloads_go_to_the_bucket(site: Site, tmp_path: Path) -> None:
    with httpx.Client(base_url=site.apis[0].url, timeout=70) as client:
        job = wait(client, submit(client, sphere(900, 3), densify=PLAIN))
        answer = client.get(job["links"]["mesh"])
        assert answer.status_code == 307
        assert answer.headers["location"].startswith(site.bucket.environment["AWS_ENDPOINT_URL"])
        assert answer.headers["etag"] == f'"{job["outputs"]["mesh.ply"]["sha256"]}"'
        head = client.head(job["links"]["mesh"])
        assert int(head.headers["content-length"]) == job["outputs"]["mesh.ply"]["bytes"]
        here = client.get(job["links"]["mesh"], params={"redirect": "false"})
        assert here.status_code == 200
        assert sha256(here.content).hexdigest() == job["outputs"]["mesh.ply"]["sha256"]
        known = {"if-none-match": answer.headers["etag"]}
        assert client.get(job["links"]["mesh"], headers=known).status_code == 304
        mesh = trimesh.load(
            io.BytesIO(httpx.get(answer.headers["location"]).content), file_type="ply"
        )
        np.testing.assert_allclose(
            np.linalg.norm(mesh.vertices, axis=1), RADIUS, atol=0.02 * RADIUS
        )
        with Client(site.apis[1].url) as service:
            path = service.mesh(job["id"], tmp_path / "mesh.ply")
        assert path.stat().st_size == job["outputs"]["mesh.ply"]["bytes"]
        assert client.delete(job["links"]["self"]).status_code == 204
        assert httpx.get(answer.headers["location"]).status_code == 404


def test_a_bucket_that_is_away(site: Site) -> None:
    site.bucket.stop()
    unknown = f"scan_{'0' * 36}"
    answer = httpx.get(f"{site.apis[0].url}/v1/scans/{unknown}", timeout=60)
    assert (answer.status_code, answer.json()["code"]) == (503, "store_unavailable")
    assert "retry-after" in answer.headers
