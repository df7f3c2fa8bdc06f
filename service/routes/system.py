"""The service about itself."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from redis.exceptions import RedisError

from service import udf_input
from service.openapi import problems
from service.problems import Problem
from service.readiness import readiness
from service.routes.jobs import MAX_WAIT_S
from service.schemas import Health, Info, Readiness
from service.services import Needs
from udflow import __version__
from udflow.config import MAX_RESOLUTION, presets, to_dict

INPUT_FORMATS = (
    *("ply", "xyz", "txt", "csv", "pts", "npy", "npz", "pcd", "las", "laz", "e57"),
    *("obj", "stl", "off", "glb"),
)
OUTPUT_FORMATS = ("ply", "glb", "obj", "stl")
LATELY = 50
router = APIRouter(tags=["system"])


@router.get("/healthz", operation_id="getHealth", summary="Is the process alive")
def get_health() -> Health:
    """Says yes as long as requests are answered; asks nobody else."""
    return Health(status="ok")


@router.get(
    "/readyz",
    operation_id="getReadiness",
    summary="Can jobs be taken and run",
    responses=problems(503),
)
def get_readiness(services: Needs) -> Readiness:
    """Whether Redis answers and keeps what it is told, a worker is alive, the disk has room."""
    checks = readiness(services)
    failed = [check for check in checks if not check.ok]
    if failed:
        raise Problem(
            "not_ready",
            "; ".join(f"{check.name}: {check.detail}" for check in failed),
            headers={"Retry-After": "5"},
            checks=[check.model_dump() for check in checks],
        )
    return Readiness(ready=True, checks=checks)


@router.get("/v1/info", operation_id="getInfo", summary="Version, presets, formats, limits")
def get_info(services: Needs) -> Info:
    """What this service can do."""
    settings = services.settings
    return Info(
        version=__version__,
        presets={name: to_dict(config) for name, config in presets().items()},
        input_formats=list(INPUT_FORMATS),
        output_formats=list(OUTPUT_FORMATS),
        limits={
            "upload_bytes": settings.max_upload_bytes,
            "resolution": MAX_RESOLUTION,
            "query_points_json": udf_input.JSON_POINTS,
            "query_points_binary": udf_input.BINARY_POINTS,
            "queued_jobs": settings.queue_limit,
            "wait_s": int(MAX_WAIT_S),
        },
        **_workshop(services),
    )


def _workshop(services: Needs) -> dict[str, Any]:
    """How many workers there are, and where they have lately run jobs."""
    try:
        records = services.records.page(LATELY).records
        devices = sorted({record.device for record in records if record.device is not None})
        return {"workers": services.dispatcher.workers(), "devices": devices}
    except RedisError:
        return {"workers": 0, "devices": []}
