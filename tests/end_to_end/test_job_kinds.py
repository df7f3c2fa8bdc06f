"""Partial meshes, extractions and retries, walked over HTTP with a real worker."""

from __future__ import annotations

import io
import time

import httpx
import numpy as np
import trimesh
from user_steps import RADIUS, Finished, sphere, submit, wait


def mesh_of(client: httpx.Client, job_id: str) -> trimesh.Trimesh:
    answer = client.get(f"/v1/jobs/{job_id}/mesh")
    assert answer.status_code == 200, answer.text
    return trimesh.load(io.BytesIO(answer.content), file_type="ply", force="mesh")


def test_a_canceled_job_can_keep_its_mesh(client: httpx.Client) -> None:
    densify = {"target_points": 100_000, "points_per_round": 100}
    job_id = submit(client, sphere(1000), densify=densify)
    while client.get(f"/v1/jobs/{job_id}").json()["round"] < 1:
        time.sleep(0.05)
    client.post(f"/v1/jobs/{job_id}/cancel", json={"keep_partial": True})
    job = wait(client, job_id)
    assert (job["state"], job["partial"]) == ("canceled", True)
    radii = np.linalg.norm(mesh_of(client, job_id).vertices, axis=1)
    np.testing.assert_allclose(radii, RADIUS, atol=0.03 * RADIUS)
    assert client.get(f"/v1/jobs/{job_id}/report").json()["partial"] is True
    asked = client.post(f"/v1/jobs/{job_id}/udf", json={"points": [[0, 0, 2 * RADIUS]]}).json()
    assert abs(asked["distance"][0] - RADIUS) < 0.05 * RADIUS


def test_a_part_is_extracted_again_and_finer(finished: Finished, client: httpx.Client) -> None:
    box = {"low": [-3, -3, 0], "high": [3, 3, 3]}
    asked = client.post(f"/v1/jobs/{finished.id}/extract", json={"resolution": 80, "box": box})
    job = wait(client, asked.json()["id"])
    assert (job["state"], job["kind"], job["source"]) == ("succeeded", "extract", finished.id)
    mesh = mesh_of(client, job["id"])
    assert mesh.vertices[:, 2].min() > -1e-6
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), RADIUS, atol=0.02 * RADIUS)
    assert len(mesh.faces) > len(mesh_of(client, finished.id).faces)
    field = client.get(f"/v1/jobs/{job['id']}/field")
    assert (field.status_code, field.json()["code"]) == (404, "artifact_not_found")
    assert finished.id in field.json()["detail"]
    nested = client.post(f"/v1/jobs/{job['id']}/extract", json={"resolution": 24}).json()
    assert nested["source"] == finished.id
    assert wait(client, nested["id"])["state"] == "succeeded"


def test_a_retry_gives_the_same_mesh(finished: Finished, client: httpx.Client) -> None:
    again = client.post(f"/v1/jobs/{finished.id}/retry").json()
    done = wait(client, again["id"])
    assert done["outputs"]["mesh.ply"]["sha256"] == finished.job["outputs"]["mesh.ply"]["sha256"]
