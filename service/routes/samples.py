"""Samples: simulated scans to try the service with."""

from __future__ import annotations

import hashlib
import io
from functools import lru_cache

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from service.downloads import matches
from service.ingest import store_scan
from service.multipart import Form
from service.openapi import problems
from service.problems import Problem
from service.routes.scans import scan_view
from service.schemas import SampleInfo, SampleList, Scan
from service.services import Needs
from udflow.cloud.samples import SAMPLES, sample
from udflow.errors import UnknownSample
from udflow.mesh.export import write_points

PLY = "application/x-ply"
router = APIRouter(prefix="/v1/samples", tags=["samples"])


@router.get("", operation_id="listSamples", summary="Simulated scans")
def list_samples() -> SampleList:
    """Scans that the service makes itself, to try things with."""
    return SampleList(
        samples=[
            SampleInfo(
                name=found.name,
                title=found.title,
                about=found.about,
                points=found.points,
                url=f"/v1/samples/{found.name}",
            )
            for found in SAMPLES.values()
        ]
    )


@router.get(
    "/{name}",
    operation_id="getSample",
    summary="A simulated scan as a file",
    response_class=Response,
    responses=problems(404)
    | {200: {"content": {PLY: {"schema": {"type": "string", "format": "binary"}}}}},
)
def get_sample(name: str, request: Request) -> Response:
    """The points as PLY. The same name always gives the same bytes."""
    body = _sample_file(name)
    etag = f'"{hashlib.sha256(body).hexdigest()}"'
    headers = {
        "ETag": etag,
        "Cache-Control": "no-cache",
        "Content-Disposition": f'attachment; filename="{name}.ply"',
    }
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type=PLY)


@router.post(
    "/{name}",
    operation_id="createSampleScan",
    summary="A simulated scan as a scan",
    status_code=201,
    response_model=Scan,
    responses=problems(404, 507) | {200: {"model": Scan, "description": "It is there already"}},
)
async def create_sample_scan(name: str, services: Needs) -> JSONResponse:
    """As if the file of `GET /v1/samples/{name}` were uploaded."""
    body = await run_in_threadpool(_sample_file, name)
    with services.store.receive() as upload:
        await run_in_threadpool(upload.write, body)
        manifest, created = await store_scan(upload, Form(filename=f"{name}.ply"), services)
    headers = {"Location": f"/v1/scans/{manifest['id']}"}
    view = scan_view(manifest).model_dump(mode="json")
    return JSONResponse(view, 201 if created else 200, headers)


@lru_cache(maxsize=len(SAMPLES))
def _sample_file(name: str) -> bytes:
    try:
        cloud = sample(name)
    except UnknownSample as error:
        raise Problem("sample_not_found", str(error)) from error
    file = io.BytesIO()
    write_points(cloud, file)
    return file.getvalue()
