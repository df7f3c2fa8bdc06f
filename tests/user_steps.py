"""The steps of a user of the service, for tests that walk the whole road."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
from api_process import npy
from numpy.typing import NDArray

SMALL = {
    "extract": {"resolution": 40},
    "densify": {"target_points": 2000, "points_per_round": 500},
}
RADIUS = 2.5
KEY = "a-key-for-the-tests-of-the-page"


@dataclass(frozen=True)
class Finished:
    """A succeeded job and the points it was made of."""

    id: str
    points: NDArray[np.float64]
    job: dict[str, Any]


def sphere(count: int, seed: int = 0) -> NDArray[np.float64]:
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return RADIUS * normals / np.linalg.norm(normals, axis=1, keepdims=True)


def submit(client: httpx.Client, points: NDArray[np.float64], **config: Any) -> str:
    """Upload and job in one go; the id of the job."""
    answer = client.post(
        "/v1/jobs",
        data={"config": json.dumps(SMALL | config)},
        files={"file": ("ball \u5c71.npy", npy(points))},
    )
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def wait(client: httpx.Client, job_id: str) -> dict[str, Any]:
    """The job when it has ended; the test's own limit ends a wait in vain."""
    while True:
        job: dict[str, Any] = client.get(f"/v1/jobs/{job_id}", params={"wait": 60}).json()
        if job.get("state") not in ("queued", "running", "canceling"):
            return job
