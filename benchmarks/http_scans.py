"""Every real scan over HTTP: upload, job, websocket, GLB and PLY, distances.

    make up                                  # in one shell
    python benchmarks/http_scans.py          # in another

One row a scan, and one for a scan moved to map coordinates (UTM) in double precision. `own` is the
largest distance that the service gives for the mesh's own vertices, in percent of the extent;
`frame` the largest distance by which the mesh leaves the box of the upload, likewise; `1 M` the
seconds for a million points by .npy, upload and download included.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import connect

from udflow.cloud.formats import read_cloud

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "scan"
UTM = np.array([512_000.0, 5_403_000.0, 300.0])
MILLION = 1_000_000
COLUMNS = (
    *("scan", "points", "upload s", "job s", "events", "rounds", "dense", "vertices", "faces"),
    *("ply MB", "glb MB", "own %", "frame %", "1 M s"),
)


@dataclass(frozen=True)
class Upload:
    """A named file to send."""

    name: str
    data: bytes


def uploads(folder: Path) -> list[Upload]:
    """All scans, and the first of them moved by UTM."""
    files = sorted(folder.glob("*.*"))
    if not files:
        sys.exit(f"no scans in {folder}; name the folder with --data")
    moved = io.BytesIO()
    np.save(moved, read_cloud(files[0]).points + UTM)
    return [
        *(Upload(file.name, file.read_bytes()) for file in files),
        Upload(f"{files[0].stem}+UTM.npy", moved.getvalue()),
    ]


def measure(client: httpx.Client, upload: Upload, config: dict[str, Any]) -> list[str]:
    """One row of the table."""
    began = time.monotonic()
    scan = checked(client.post("/v1/scans", files={"file": (upload.name, upload.data)})).json()
    uploaded_s = time.monotonic() - began
    body = {"scan_id": scan["id"], "config": config}
    job = checked(client.post("/v1/jobs", json=body)).json()
    began = time.monotonic()
    events = follow(client, job["links"]["events"])
    job_s = time.monotonic() - began
    job = checked(client.get(job["links"]["self"])).json()
    if job["state"] != "succeeded":
        raise SystemExit(f"{upload.name}: {job['state']}, {job['error']}")
    ply = checked(client.get(job["links"]["mesh"], params={"format": "ply"})).content
    glb = checked(client.get(job["links"]["mesh"], params={"format": "glb"})).content
    vertices = vertices_of(ply)
    extent = max(scan["extent"])
    own = ask(client, job, vertices).max() / extent
    low, high = np.array(scan["low"]), np.array(scan["high"])
    outside = max(float((low - vertices).max()), float((vertices - high).max()), 0.0) / extent
    began = time.monotonic()
    cloud = np.random.default_rng(0).uniform(low, high, (MILLION, 3))
    ask(client, job, cloud)
    million_s = time.monotonic() - began
    return [
        upload.name,
        str(scan["points"]),
        f"{uploaded_s:.1f}",
        f"{job_s:.1f}",
        str(len(events)),
        str(job["rounds"]),
        str(job["points"]),
        str(len(vertices)),
        str(faces_in(ply)),
        f"{len(ply) / 1e6:.1f}",
        f"{len(glb) / 1e6:.1f}",
        f"{100 * own:.4f}",
        f"{100 * outside:.2f}",
        f"{million_s:.1f}",
    ]


def follow(client: httpx.Client, path: str) -> list[dict[str, Any]]:
    """All events of a job by websocket, until the server closes it."""
    url = str(client.base_url.join(path)).replace("http", "ws", 1)
    with connect(url + "?after=0-0", max_queue=None) as socket:
        return [json.loads(message) for message in socket]


def ask(client: httpx.Client, job: dict[str, Any], points: NDArray[np.float64]) -> Any:
    """Distances by .npy, one a point."""
    body = io.BytesIO()
    np.save(body, points)
    answer = checked(client.post(job["links"]["udf"], content=body.getvalue()))
    distances = np.load(io.BytesIO(answer.content), allow_pickle=False)
    if distances.shape != (len(points),) or not np.isfinite(distances).all():
        raise SystemExit("the distances are incomplete")
    return distances


def vertices_of(ply: bytes) -> NDArray[np.float64]:
    with tempfile.NamedTemporaryFile(suffix=".ply") as file:
        file.write(ply)
        file.flush()
        return read_cloud(Path(file.name)).points


def faces_in(ply: bytes) -> int:
    line = next(line for line in ply.split(b"\n", 40) if line.startswith(b"element face"))
    return int(line.split()[-1])


def checked(answer: httpx.Response) -> httpx.Response:
    if answer.is_error:
        raise SystemExit(f"{answer.request.method} {answer.request.url}: {answer.text}")
    return answer


def main() -> None:
    """Prints the table row by row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with the scans")
    parser.add_argument("--config", type=json.loads, default={}, help="JSON, as in a job")
    options = parser.parse_args()
    with httpx.Client(base_url=options.url, timeout=600) as client:
        info = checked(client.get("/v1/info")).json()
        print(f"udflow {info['version']} at {options.url}, config {json.dumps(options.config)}\n")
        print("| " + " | ".join(COLUMNS) + " |")
        print("|" + "---|" * len(COLUMNS))
        for upload in uploads(options.data):
            print("| " + " | ".join(measure(client, upload, options.config)) + " |", flush=True)


if __name__ == "__main__":
    main()
