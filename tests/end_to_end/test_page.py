"""The page in a real browser (headless, software GL), on the real service."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trimesh
from api_process import ROOT
from chaos_kit import SOAK, say
from s3_server import S3Server
from user_steps import KEY
from whole_service import running

from jobs.previews import Previews
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.spec import JobSpec
from udflow.config import preset, to_dict
from udflow.progress import GrownCloud
from worker.frames import points_frame

WEB = ROOT / "web"
BUDGET = 250_000  # bytes before data
FRAMES = 500 if SOAK else 60
POINTS = 12_000

pytestmark = pytest.mark.timeout(400)
Walk = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def browser() -> str:
    """Where Chromium is. What is missing is named: without it the page goes untested."""
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if found is None:
        pytest.skip("NO BROWSER: install chromium, or set CHROMIUM to one")
    if shutil.which("node") is None or not (WEB / "node_modules" / "playwright-core").exists():
        pytest.skip("NO NODE or no packages: `make page` fetches them")
    if not (WEB / "dist" / "index.html").exists():
        pytest.skip("NO PAGE: `make page` builds it")
    return found


@pytest.fixture
def walk(browser: str, url: str, tmp_path: Path) -> Walk:
    """Runs a walk of web/e2e/walks.mjs; what it has found."""

    def act(name: str, **more: Any) -> dict[str, Any]:
        settings = {"url": url, "chromium": browser, "out": str(tmp_path), **more}
        done = subprocess.run(
            ["node", "walks.mjs", name, json.dumps(settings)],
            cwd=WEB / "e2e",
            capture_output=True,
            text=True,
            check=False,
            timeout=380,
        )
        assert done.returncode == 0, done.stderr[-4000:]
        sys.stdout.write(done.stdout)  # the figures; shown by `pytest -rP`
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    return act


def test_from_drop_to_download(walk: Walk, tmp_path: Path) -> None:
    found = walk("whole")
    assert found["before_data"] < found["with_all_parts"] < BUDGET
    mesh = trimesh.load_mesh(tmp_path / "mesh.glb")
    assert len(mesh.faces) > 500
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([2, 2, 2], abs=0.1)


def test_a_job_is_shown_again_after_a_reload_in_another_tab_and_by_an_api_that_comes_back(
    walk: Walk, data_folder: Path
) -> None:
    assert walk("again", api=api_process(data_folder))["round"] >= 2


def test_a_stopped_job_ends_in_what_was_asked(walk: Walk) -> None:
    walk("stopped")


def test_trouble_is_told_in_words(walk: Walk) -> None:
    walk("trouble")


def test_a_key_is_used_everywhere_and_results_may_lie_in_a_bucket(walk: Walk, far_url: str) -> None:
    assert walk("locked", url=far_url, key=KEY)["sent"] > 0


@pytest.fixture
def far_url(tmp_path: Path) -> Iterator[str]:
    """A service that wants KEY and keeps its results elsewhere."""
    with S3Server(tmp_path / "s3") as bucket:
        elsewhere = bucket.environment | {"STORE_URL": "s3://bucket/page"}
        with running(tmp_path / "data", UDFLOW_KEY=KEY, **elsewhere) as address:
            yield address


def test_many_frames_are_drawn_in_the_same_memory(walk: Walk, shown_job: str) -> None:
    found = walk("frames", job=shown_job, frames=FRAMES)
    assert found["late"] < 1.1 * found["early"] + 2e6
    assert found["median_ms"] < 1000
    say(
        f"{found['drawn']} frames of {POINTS} points: drawn {found['median_ms']:.0f} ms after they "
        f"came (95 %: {found['p95_ms']:.0f} ms), heap {found['early'] / 1e6:.1f} MB early, "
        f"{found['late'] / 1e6:.1f} MB late"
    )


@pytest.fixture
def shown_job(data_folder: Path, client: httpx.Client) -> Iterator[str]:
    """A running job of which this test is the worker: a frame whenever there was time for it."""
    settings = Settings(data=data_folder, redis_url=EmbeddedRedis(data_folder).url)
    scan = client.post("/v1/samples/vase").json()
    with settings.connect() as connection:
        records = JobRecords(connection)
        spec = JobSpec.new(scan["id"], to_dict(preset("fast")))
        records.create(spec)
        assert records.claim(spec.id, 1) is not None
        stopping = threading.Event()
        showing = threading.Thread(
            target=_show_frames, args=(records, Previews(connection), spec.id, stopping)
        )
        showing.start()
        yield spec.id
        stopping.set()
        showing.join()
        records.request_cancel(spec.id)


def _show_frames(
    records: JobRecords, previews: Previews, job_id: str, stopping: threading.Event
) -> None:
    """Frames of a growing ball, much faster than a worker sends them."""
    normal = np.random.default_rng(0).normal(size=(POINTS, 3))
    points = 0.1 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    sequence = 0
    while not stopping.is_set():
        sequence += 1
        count = 1000 + (POINTS - 1000) * (sequence % 50) // 49
        cloud = GrownCloud(points[:count], np.arange(count) // 3000)
        previews.put(job_id, "points", points_frame(cloud, sequence, 13))
        notice = {"kind": "points", "sequence": sequence}
        records.update(job_id, 1, ("preview", notice))
        records.renew_lease(job_id, 1)
        time.sleep(0.06)


def api_process(data: Path) -> int:
    """The process id of the API: whoever listens for `service.up` with this data folder."""
    wanted = f"UDFLOW_DATA={data}".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes()
            if b"service.serve" in command and wanted in (folder / "environ").read_bytes():
                return int(folder.name)
        except OSError:
            continue  # it ended while it was looked at
    raise AssertionError("no API is running")
