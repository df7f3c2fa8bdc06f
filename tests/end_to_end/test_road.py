"""Scan in, mesh out, as a user goes: upload, job, websocket, files, distances."""

from __future__ import annotations

import hashlib
import io
import json
import re
import struct
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trimesh
from api_process import npy
from user_steps import RADIUS, SMALL, Finished, sphere, submit, wait
from websockets.sync.client import connect

from udflow.cloud.formats import read_cloud
from udflow.fields.storage import load_field

UTM = np.array([512_000.0, 5_403_000.0, 300.0])

FRAMES = ("", "&frame=world", "&frame=local")


def coloured_ply(points: Any) -> bytes:
    """Binary PLY with double coordinates and a colour that tells the upper half."""
    rows = np.zeros(len(points), [("xyz", "<f8", 3), ("rgb", "u1", 3)])
    rows["xyz"] = points
    rows["rgb"] = np.where(points[:, 2:] > points[:, 2].mean(), [250, 20, 20], [20, 20, 250])
    properties = [f"property double {axis}" for axis in "xyz"]
    properties += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    return ("\n".join([*header, *properties, "end_header"]) + "\n").encode() + rows.tobytes()


def vertices(data: bytes, tmp_path: Path, suffix: str) -> Any:
    path = tmp_path / f"mesh.{suffix}"
    path.write_bytes(data)
    return read_cloud(path)


def test_from_upload_to_distances(url: str, client: httpx.Client, tmp_path: Path) -> None:
    points = sphere(1200, seed=5)
    uploaded = client.post("/v1/scans", files={"file": ("ball.ply", coloured_ply(points))})
    assert uploaded.status_code == 201
    scan = uploaded.json()
    assert (scan["points"], scan["has_colors"]) == (1200, True)
    asked = client.post("/v1/jobs", json={"scan_id": scan["id"], "config": SMALL})
    assert asked.status_code == 202
    job = asked.json()

    events = []
    with connect(url.replace("http", "ws") + job["links"]["events"] + "?after=0-0") as socket:
        events = [json.loads(message) for message in socket]
        assert socket.close_code == 1000
    assert events[0]["type"] == "snapshot"
    assert events[-1]["type"] == "end"
    assert events[-1]["data"]["state"] == "succeeded"
    stages = [event["data"]["stage"] for event in events if event["type"] == "stage"]
    assert stages == ["reading", "fitting", "densifying", "extracting", "exporting"]
    told = [event["data"] for event in events if "progress" in event["data"]][1:]
    assert [data["progress"] for data in told] == sorted(data["progress"] for data in told)
    rounds = [event["data"] for event in events if event["type"] == "densify"]
    assert [data["round"] for data in rounds] == list(range(1, len(rounds) + 1))
    assert rounds[0]["points"] > 1200
    assert told[-1]["loss"] < 1e-3

    job = client.get(job["links"]["self"]).json()
    assert (job["state"], job["progress"], job["stage"]) == ("succeeded", 1.0, "exporting")
    assert job["points"] == rounds[-1]["points"]
    for name in ("ply", "glb", "obj", "stl"):
        answer = client.get(f"{job['links']['mesh']}?format={name}")
        assert (
            hashlib.sha256(answer.content).hexdigest() == job["outputs"][f"mesh.{name}"]["sha256"]
        )
        mesh = trimesh.load(io.BytesIO(answer.content), file_type=name, force="mesh")
        radii = np.linalg.norm(mesh.vertices, axis=1)
        np.testing.assert_allclose(radii, RADIUS, atol=0.02 * RADIUS)
        assert len(mesh.faces) > 1000

    ply = vertices(client.get(job["links"]["mesh"]).content, tmp_path, "ply")
    upper = ply.points[:, 2] > 0.3
    assert (ply.colors[upper, 0] > ply.colors[upper, 2]).all()
    dense = vertices(client.get(job["links"]["points"]).content, tmp_path, "ply")
    assert len(dense.points) == job["points"]
    report = client.get(job["links"]["report"]).json()
    assert report["config"] == job["config"]
    own = client.post(job["links"]["udf"], content=npy(ply.points))
    assert np.load(io.BytesIO(own.content)).max() < 0.002 * 2 * RADIUS


@pytest.fixture(scope="module")
def far_job(url: str) -> str:
    """The id of a succeeded job on a sphere in map coordinates."""
    with httpx.Client(base_url=url, timeout=70) as client:
        job_id = submit(client, sphere(1500) + UTM)
        job = wait(client, job_id)
    assert job["state"] == "succeeded", job["error"]
    return job_id


def test_map_coordinates_come_back(far_job: str, client: httpx.Client, tmp_path: Path) -> None:
    ply = vertices(client.get(f"/v1/jobs/{far_job}/mesh").content, tmp_path, "ply").points
    np.testing.assert_allclose(np.linalg.norm(ply - UTM, axis=1), RADIUS, atol=0.02 * RADIUS)
    own = client.post(f"/v1/jobs/{far_job}/udf", params={"closest": True}, content=npy(ply))
    answer = np.load(io.BytesIO(own.content))
    assert answer["valid"].all()
    assert answer["distance"].max() < 0.002 * 2 * RADIUS
    np.testing.assert_allclose(answer["closest"], ply, atol=0.002 * 2 * RADIUS)
    glb = client.get(f"/v1/jobs/{far_job}/mesh?format=glb").content
    described = json.loads(glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])
    shift = described["asset"]["extras"]["udflow"]["shift"]
    local = trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh").vertices
    extent = np.abs(local).max()
    assert extent < 1e4, "map coordinates in single precision"
    np.testing.assert_allclose(shift, UTM, atol=1e4)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_the_frame_of_a_mesh_can_be_chosen(
    suffix: str, far_job: str, client: httpx.Client, tmp_path: Path
) -> None:
    url = f"/v1/jobs/{far_job}/mesh?format="
    plain, world = client.get(url + suffix), client.get(f"{url}{suffix}&frame=world")
    assert plain.content == world.content
    local = client.get(f"{url}{suffix}&frame=local")
    shift = re.search(rb"shift (\S+) (\S+) (\S+)", local.content[:400])
    assert shift is not None
    there = vertices(local.content, tmp_path, suffix).points
    assert np.abs(there).max() < 1e4
    whole = vertices(plain.content, tmp_path, suffix).points
    np.testing.assert_allclose(there + np.array(shift.groups(), float), whole, rtol=0, atol=1e-8)
    assert "-local." in local.headers["content-disposition"]
    assert local.headers["etag"] != plain.headers["etag"]
    rest = client.get(f"{url}{suffix}&frame=local", headers={"range": "bytes=100-"})
    assert (rest.status_code, rest.content) == (206, local.content[100:])
    for single in ("glb", "stl"):
        assert client.get(f"{url}{single}&frame=local").content == client.get(url + single).content
        refused = client.get(f"{url}{single}&frame=world")
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid_request")
        assert refused.json()["errors"][0]["pointer"] == "?frame"


def test_near_the_origin_both_frames_are_one(finished: Finished, client: httpx.Client) -> None:
    for suffix in ("ply", "obj", "glb", "stl"):
        url = f"/v1/jobs/{finished.id}/mesh?format={suffix}"
        etags = {client.get(f"{url}{more}").headers["etag"] for more in FRAMES}
        assert len(etags) == 1


def test_the_field_can_be_taken_home(
    finished: Finished, client: httpx.Client, tmp_path: Path
) -> None:
    path = tmp_path / "field.safetensors"
    path.write_bytes(client.get(f"/v1/jobs/{finished.id}/field").content)
    points = sphere(50, seed=9) * 1.1
    there = client.post(f"/v1/jobs/{finished.id}/udf", json={"points": points.tolist()}).json()
    here = load_field(path).query(points)
    np.testing.assert_allclose(here.distance, there["distance"], atol=1e-6)


def test_a_download_can_be_resumed(finished: Finished, client: httpx.Client) -> None:
    url = f"/v1/jobs/{finished.id}/mesh?format=obj"
    whole = client.get(url)
    size = len(whole.content)
    assert whole.headers["etag"] == f'"{finished.job["outputs"]["mesh.obj"]["sha256"]}"'
    assert (
        whole.headers["content-disposition"] == "attachment; filename*=utf-8''ball%20%E5%B1%B1.obj"
    )
    assert whole.headers["x-content-type-options"] == "nosniff"
    rest = client.get(url, headers={"range": "bytes=1000-", "if-range": whole.headers["etag"]})
    assert rest.status_code == 206
    assert rest.headers["content-range"] == f"bytes 1000-{size - 1}/{size}"
    assert whole.content[:1000] + rest.content == whole.content
    last = client.get(url, headers={"range": "bytes=-10"})
    assert (last.status_code, last.content) == (206, whole.content[-10:])


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"range": "bytes=999999999-"}, 416),
        ({"range": "bytes=-0"}, 416),
        ({"range": "bytes=5-2"}, 200),
        ({"range": "lines=1-2"}, 200),
        ({"range": "bytes=0-0", "if-range": '"other"'}, 200),
        ({"if-none-match": '"other"'}, 200),
        ({"if-none-match": "*"}, 304),
    ],
)
def test_ranges_and_validators(
    headers: dict[str, str], status: int, finished: Finished, client: httpx.Client
) -> None:
    answer = client.get(f"/v1/jobs/{finished.id}/mesh?format=stl", headers=headers)
    assert answer.status_code == status
    if status == 416:
        size = finished.job["outputs"]["mesh.stl"]["bytes"]
        assert answer.headers["content-range"] == f"bytes */{size}"
        assert answer.json()["code"] == "range_not_satisfiable"


def test_a_known_file_is_not_sent_again(finished: Finished, client: httpx.Client) -> None:
    url = f"/v1/jobs/{finished.id}/mesh?format=glb"
    head = client.head(url)
    size = finished.job["outputs"]["mesh.glb"]["bytes"]
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == size
    again = client.get(url, headers={"if-none-match": f'W/"x", {head.headers["etag"]}'})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == head.headers["etag"]


def test_an_unknown_mesh_format(finished: Finished, client: httpx.Client) -> None:
    answer = client.get(f"/v1/jobs/{finished.id}/mesh?format=step")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "?format"


def test_cancel_during_and_before_the_run(client: httpx.Client) -> None:
    """A long fit is stopped while it runs, and the job behind it before it starts."""
    long = submit(client, sphere(4000), extract={"resolution": 512}, densify={})
    behind = submit(client, sphere(200))
    while client.get(f"/v1/jobs/{long}").json()["state"] == "queued":
        time.sleep(0.02)
    mesh = client.get(f"/v1/jobs/{long}/mesh")
    assert (mesh.status_code, mesh.json()["code"]) == (409, "job_not_finished")
    assert client.post(f"/v1/jobs/{behind}/cancel").json()["state"] == "canceled"
    first = client.post(f"/v1/jobs/{long}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceling")
    assert client.post(f"/v1/jobs/{long}/cancel").status_code == 202
    assert wait(client, long)["state"] == "canceled"
    after = client.get(f"/v1/jobs/{long}/mesh")
    assert (after.status_code, after.json()["code"]) == (409, "job_failed")
    assert client.get(f"/v1/jobs/{behind}").json()["started_at"] is None


def test_the_same_job_twice_gives_the_same_mesh(finished: Finished, client: httpx.Client) -> None:
    again = wait(client, submit(client, finished.points))
    assert again["scan_id"] == finished.job["scan_id"]
    for name in ("mesh.ply", "mesh.glb", "field.safetensors"):
        assert again["outputs"][name]["sha256"] == finished.job["outputs"][name]["sha256"]


def test_the_service_says_what_it_can_do(finished: Finished, client: httpx.Client) -> None:
    ready = client.get("/readyz").json()
    assert ready["ready"] is True
    assert {check["name"] for check in ready["checks"]} == {"redis", "worker", "disk"}
    info = client.get("/v1/info").json()
    assert info["presets"]["fast"]["extract"]["resolution"] == 256
    assert (info["workers"], info["devices"]) == (1, [finished.job["device"]])
