"""Jobs that end early with a mesh, make only some files, or extract again from a stored field."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import trimesh
from shapes import Sphere
from workshop import LONG, QUICK, Workshop

from jobs import keys
from jobs.costs import sample_of
from jobs.spec import JobRecord, JobSpec, JobState
from jobs.submission import submit
from udflow.config import from_dict, to_dict
from worker.calibrate import measured


def radii(shop: Workshop, record: JobRecord) -> np.ndarray:
    mesh = trimesh.load_mesh(shop.store.artifact_path(record.outputs["mesh.ply"]))
    return np.linalg.norm(mesh.vertices, axis=1)


def offer(shop: Workshop, spec: JobSpec) -> str:
    return submit(spec, shop.records, shop.store, shop.dispatcher).record.id


def test_a_canceled_fit_may_keep_what_it_has(shop: Workshop) -> None:
    job_id = shop.submit(QUICK | LONG)
    shop.until(lambda: shop.get(job_id).round >= 2, 40.0)
    asked = shop.records.request_cancel(job_id, keep_partial=True)
    assert asked is not None
    assert (asked.state, asked.keep_partial) == (JobState.CANCELING, True)
    record = shop.reaches(job_id, JobState.CANCELED)
    np.testing.assert_allclose(radii(shop, record), 0.5, atol=0.03)
    report = json.loads(shop.store.artifact_path(record.outputs["report.json"]).read_text())
    assert report["partial"] is True
    assert shop.states(job_id) == ["queued", "running", "canceling", "canceled"]


def test_a_second_cancel_gives_the_mesh_up(shop: Workshop) -> None:
    job_id = shop.submit(LONG | {"extract": {"resolution": 256}})
    shop.is_fitting(job_id)
    shop.records.request_cancel(job_id, keep_partial=True)
    shop.records.request_cancel(job_id)
    record = shop.reaches(job_id, JobState.CANCELED)
    assert record.outputs == {}
    assert not list((shop.store.root / "jobs" / job_id).glob("a[0-9]*"))


def test_only_the_wanted_files_are_made(shop: Workshop) -> None:
    scan = shop.scan(Sphere().sample(800).numpy())
    job_id = offer(shop, JobSpec.new(scan, QUICK, wanted=("mesh.glb", "report.json")))
    record = shop.reaches(job_id, JobState.SUCCEEDED)
    assert set(record.outputs) == {"mesh.glb", "report.json"}


def test_another_mesh_from_the_same_field(shop: Workshop) -> None:
    first = shop.reaches(shop.submit(), JobState.SUCCEEDED)
    box = ((-1.0, -1.0, -1.0), (1.0, 1.0, 0.0))
    config = QUICK | {"extract": {"resolution": 48}}
    spec = JobSpec.new(first.scan_id, config, kind="extract", source=first.id, box=box)
    record = shop.reaches(offer(shop, spec), JobState.SUCCEEDED)
    assert (record.kind, record.source, record.box) == ("extract", first.id, box)
    mesh = trimesh.load_mesh(shop.store.artifact_path(record.outputs["mesh.ply"]))
    assert mesh.vertices[:, 2].max() < 1e-9
    assert (
        len(mesh.faces)
        > 1.5
        * json.loads(shop.store.artifact_path(first.outputs["report.json"]).read_text())["mesh"][
            "faces"
        ]
    )
    np.testing.assert_allclose(radii(shop, record), 0.5, atol=0.03)


def test_the_field_may_be_gone_by_then(shop: Workshop) -> None:
    first = shop.reaches(shop.submit(), JobState.SUCCEEDED)
    shop.store.delete_job(first.id)
    spec = JobSpec.new(first.scan_id, QUICK, kind="extract", source=first.id)
    record = shop.reaches(offer(shop, spec), JobState.FAILED)
    assert record.error is not None
    assert record.error.code == "source_gone"


def test_what_a_job_took_is_remembered(shop: Workshop) -> None:
    config = to_dict(from_dict(QUICK))
    shop.connection.delete(keys.costs("fast", "reconstruct"))
    record = shop.reaches(shop.submit(config), JobState.SUCCEEDED)
    key = keys.costs("fast", "reconstruct")
    shop.until(lambda: shop.connection.llen(key) == 1, 10.0)
    sample = sample_of(json.loads(shop.connection.lindex(key, 0)))
    assert record.started_at is not None
    assert record.finished_at is not None
    lasted = record.finished_at - record.started_at
    assert 0.3 * lasted < sample.seconds < 3 * lasted + 1
    assert 100e6 < sample.memory < sample.machine_memory


def test_calibration_measures_this_machine(own_shop: Workshop) -> None:
    sample = measured(500, QUICK, "cpu")
    assert 0 < sample.seconds < 60
    assert sample.workload.resolution == 24
    assert sample_of(json.loads(json.dumps(asdict(sample)))) == sample
