"""One job at a real worker process, from the queue to its files."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from shapes import Sphere
from workshop import LONG, QUICK, Workshop, until

from jobs.ids import new_id
from jobs.spec import JobSpec, JobState
from jobs.submission import submit
from worker.trainer import train

FILES = {
    "mesh.ply",
    "mesh.glb",
    "mesh.obj",
    "mesh.stl",
    "points.ply",
    "field.safetensors",
    "report.json",
    "preview.png",
}


def test_a_sphere_becomes_a_mesh(shop: Workshop) -> None:
    job_id = shop.submit()
    record = shop.reaches(job_id, JobState.SUCCEEDED)
    assert set(record.outputs) == FILES
    for artifact in record.outputs.values():
        content = shop.store.artifact_path(artifact).read_bytes()
        assert (len(content), hashlib.sha256(content).hexdigest()) == (
            artifact.bytes,
            artifact.sha256,
        )
    mesh = trimesh.load_mesh(shop.store.artifact_path(record.outputs["mesh.ply"]))
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - 0.5).max() < 0.03
    report = json.loads(shop.store.artifact_path(record.outputs["report.json"]).read_text())
    assert report["mesh"]["vertices"] == len(mesh.vertices)
    assert (record.attempt, record.progress, record.eta_s, record.device) == (1, 1.0, None, "cpu")
    assert shop.temporary_files() == []
    assert shop.records.request_cancel(job_id) == record  # finished is finished
    until(lambda: not shop.connection.keys(f"rq:*{job_id}*"), 10.0)


def test_its_progress_is_told_in_order(shop: Workshop) -> None:
    config = QUICK | {"densify": {"target_points": 1200, "points_per_round": 200}}
    job_id = shop.submit(config)
    record = shop.reaches(job_id, JobState.SUCCEEDED)
    told = shop.told(job_id)
    assert shop.states(job_id) == ["queued", "running", "succeeded"]
    assert told[-1].type == "end"
    moving = [event.data for event in told if event.type in ("stage", "progress", "densify")]
    shares = [data["progress"] for data in moving]
    assert shares == sorted(shares)
    stages = [event.data["stage"] for event in told if event.type == "stage"]
    assert stages == ["reading", "fitting", "densifying", "extracting", "exporting"]
    rounds = [event.data["round"] for event in told if event.type == "densify"]
    assert rounds == list(range(1, record.round + 1))
    assert record.round >= 2
    points = [event.data["points"] for event in told if event.type == "densify"]
    assert points == sorted(set(points))  # every round grows the real cloud
    losses = [data["loss"] for data in moving if data["loss"] is not None]
    assert record.loss == losses[-1] > 0.0
    assert record.points == points[-1] >= 1200


def test_a_canceled_fit_stops_by_itself(shop: Workshop) -> None:
    job_id = shop.submit(LONG)
    shop.is_fitting(job_id)
    asked = shop.records.request_cancel(job_id)
    assert asked is not None
    assert asked.state is JobState.CANCELING
    shop.reaches(job_id, JobState.CANCELED)
    assert shop.states(job_id) == ["queued", "running", "canceling", "canceled"]
    assert not list((shop.store.root / "jobs" / job_id).glob("a[0-9]*"))


def test_a_job_canceled_in_the_queue_never_starts(shop: Workshop) -> None:
    first = shop.submit(LONG)
    waiting = shop.submit()
    canceled = shop.records.request_cancel(waiting)
    assert canceled is not None
    assert canceled.state is JobState.CANCELED
    shop.records.request_cancel(first)
    shop.reaches(first, JobState.CANCELED)
    shop.reaches(shop.submit(), JobState.SUCCEEDED)  # by now the worker has passed the other
    assert shop.states(waiting) == ["queued", "canceled"]


def test_a_job_deleted_while_it_runs_disappears(shop: Workshop) -> None:
    job_id = shop.submit(LONG)
    shop.is_fitting(job_id)
    assert shop.records.delete(job_id, force=True)
    shop.store.delete_job(job_id)
    shop.reaches(shop.submit(), JobState.SUCCEEDED)  # the worker is free again
    assert shop.records.get(job_id) is None
    assert not (shop.store.root / "jobs" / job_id / "a1").exists()


@pytest.mark.parametrize(
    ("points", "code", "words"),
    [
        (np.zeros((500, 3)), "invalid_cloud", "2 distinct"),
        (np.random.default_rng(0).random((20, 3)), "invalid_cloud", "100"),
    ],
)
def test_a_hopeless_cloud_fails_in_words(
    shop: Workshop, points: np.ndarray, code: str, words: str
) -> None:
    record = shop.reaches(shop.submit(scan_id=shop.scan(points)), JobState.FAILED)
    assert record.error is not None
    assert record.error.code == code
    assert words in record.error.message
    assert record.outputs == {}


def test_a_scan_that_was_deleted_fails_in_words(shop: Workshop) -> None:
    record = shop.reaches(shop.submit(scan_id=new_id("scan")), JobState.FAILED)
    assert record.error is not None
    assert (record.error.code, "deleted" in record.error.message) == ("invalid_cloud", True)


def test_an_impossible_parameter_fails_in_words(shop: Workshop) -> None:
    record = shop.reaches(shop.submit({"extract": {"resolution": 100_000}}), JobState.FAILED)
    assert record.error is not None
    assert (record.error.code, "16 to 1024" in record.error.message) == ("invalid_config", True)


def test_an_unexpected_error_keeps_its_traceback_in_the_log(shop: Workshop) -> None:
    spec = JobSpec.new(shop.scan(Sphere().sample(800).numpy()), QUICK)
    in_the_way = shop.store.root / "jobs" / spec.id / "a1"
    in_the_way.parent.mkdir()
    in_the_way.touch()
    submit(spec, shop.records, shop.store, shop.dispatcher)
    record = shop.reaches(spec.id, JobState.FAILED)
    assert record.error is not None
    assert record.error.code == "internal"
    assert "Traceback" not in record.error.message
    assert "FileExistsError" in shop.log()


def test_a_job_that_runs_too_long_ends(own_shop: Workshop) -> None:
    job_id = own_shop.submit(LONG)
    train(job_id, 1, replace(own_shop.settings, job_timeout_s=0.3, device="cpu"))
    record = own_shop.get(job_id)
    assert record.error is not None
    assert (record.state, record.error.code) == (JobState.FAILED, "timeout")
    assert record.stage in ("fitting", "densifying")


def test_retention_removes_record_and_files(shop: Workshop) -> None:
    scan = shop.scan(np.zeros((3, 3)))
    spec = replace(JobSpec.new(scan, QUICK), ttl_s=0.1)
    submit(spec, shop.records, shop.store, shop.dispatcher)
    shop.reaches(spec.id, JobState.FAILED)
    until(lambda: shop.records.now() > (shop.get(spec.id).expires_at or 0.0), 5.0)
    shop.reaper.sweep()
    assert shop.records.get(spec.id) is None
    assert shop.records.is_gone(spec.id)
    assert not (shop.store.root / "jobs" / spec.id).exists()
