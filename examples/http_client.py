"""The service from another program: upload, follow, download, ask. Start it with `make up`.

    python examples/http_client.py scan.ply mesh.glb --url http://127.0.0.1:8000

UDFLOW_KEY holds the key of a service that asks for one.
"""

import argparse
import io
import json
import os
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.sync.client import connect


def follow(url: httpx.URL, headers: dict[str, str]) -> dict[str, Any]:
    """Print the progress of a job until its end; the job as the last message has it.

    A client that loses the connection comes back with ?after=<id of the last event it saw>.
    """
    scheme = "wss" if url.scheme == "https" else "ws"
    job: dict[str, Any] = {}
    with connect(str(url.copy_with(scheme=scheme)), additional_headers=headers) as socket:
        for message in map(json.loads, socket):
            if message["type"] == "heartbeat":
                continue
            job |= message["data"]
            if message["type"] in ("stage", "progress", "densify"):
                print(f"{job['progress']:4.0%} {job['stage']}, {job['points']} points")
    return job


def distances(client: httpx.Client, job: dict[str, Any], points: np.ndarray[Any, Any]) -> Any:
    """Unsigned distances (n,) from points (n, 3), in the units of the scan."""
    body = io.BytesIO()
    np.save(body, points)
    reply = client.post(job["links"]["udf"], content=body.getvalue())
    reply.raise_for_status()
    return np.load(io.BytesIO(reply.content), allow_pickle=False)


def main(scan: Path, mesh: Path, url: str, config: str) -> None:
    """One scan, all the way."""
    key = os.environ.get("UDFLOW_KEY")
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with httpx.Client(base_url=url, headers=headers, timeout=60) as client:
        with scan.open("rb") as file:
            form = {"config": config, "metadata": '{"from": "an example"}'}
            reply = client.post("/v1/jobs", files={"file": (scan.name, file)}, data=form)
        if reply.is_error:
            raise SystemExit(f"refused: {reply.json()['detail']}")
        job = reply.json()
        print(f"{job['id']} is {job['state']}")

        follow(client.base_url.join(job["links"]["events"]), headers)

        job = client.get(job["links"]["self"]).raise_for_status().json()
        if job["state"] != "succeeded":
            raise SystemExit(f"{job['state']}: {job['error']}")
        format = mesh.suffix.lstrip(".")
        with client.stream("GET", job["links"]["mesh"], params={"format": format}) as download:
            download.raise_for_status()
            with mesh.open("wb") as file:
                file.writelines(download.iter_bytes())
        print(f"{mesh}: {mesh.stat().st_size} bytes")

        origin = distances(client, job, np.zeros((1, 3)))
        print(f"the origin is {origin[0]:.4g} from the surface")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scan", type=Path)
    parser.add_argument("mesh", type=Path, help=".ply, .glb, .obj or .stl")
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--config", default="{}", help="JSON, such as '{\"seed\": 7}'")
    options = parser.parse_args()
    main(options.scan, options.mesh, options.url, options.config)
