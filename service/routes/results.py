"""The files of a finished job as downloads."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from service.downloads import file_response, redirected
from service.openapi import Answers, problems
from service.results import result_file
from service.routes.jobs import find_job
from service.services import Needs, Services

MEDIA_TYPES = {
    "ply": "application/x-ply",
    "glb": "model/gltf-binary",
    "obj": "model/obj",
    "stl": "model/stl",
    "safetensors": "application/octet-stream",
    "json": "application/json",
    "png": "image/png",
}
MeshFormat = Annotated[Literal["ply", "glb", "obj", "stl"], Query(description="file format")]
router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])


def _answers(*media_types: str) -> Answers:
    content = {media_type: {"schema": _schema(media_type)} for media_type in media_types}
    found: Answers = {
        200: {"content": content, "description": "The file"},
        206: {"content": content, "description": "The asked range of the file"},
        304: {"description": "The file is the one of If-None-Match"},
    }
    return found | problems(404, 409, 410, 416, 503)


def _schema(media_type: str) -> dict[str, str]:
    if media_type == MEDIA_TYPES["json"]:
        return {"type": "object"}
    return {"type": "string", "format": "binary"}


@router.head("/mesh", include_in_schema=False)
@router.get(
    "/mesh",
    operation_id="getMesh",
    summary="The mesh",
    response_class=Response,
    responses=_answers(*(MEDIA_TYPES[name] for name in ("ply", "glb", "obj", "stl"))),
)
def get_mesh(
    job_id: str, request: Request, services: Needs, format: MeshFormat = "ply"
) -> Response:
    """Triangles in the units and frame of the scan.

    PLY and OBJ hold the coordinates in full; GLB and STL hold single precision, GLB with the
    place of its origin in the root node.
    """
    return _download(job_id, f"mesh.{format}", request, services)


@router.head("/points", include_in_schema=False)
@router.get(
    "/points",
    operation_id="getPoints",
    summary="The densified cloud",
    response_class=Response,
    responses=_answers(MEDIA_TYPES["ply"]),
)
def get_points(job_id: str, request: Request, services: Needs) -> Response:
    """The scan's points and those added by densification, as PLY."""
    return _download(job_id, "points.ply", request, services)


@router.head("/field", include_in_schema=False)
@router.get(
    "/field",
    operation_id="getField",
    summary="The fitted field",
    response_class=Response,
    responses=_answers(MEDIA_TYPES["safetensors"]),
)
def get_field(job_id: str, request: Request, services: Needs) -> Response:
    """The field as safetensors, for `udflow query` and `udflow.fields.storage.load_field`."""
    return _download(job_id, "field.safetensors", request, services)


@router.head("/report", include_in_schema=False)
@router.get(
    "/report",
    operation_id="getReport",
    summary="The report",
    response_class=Response,
    responses=_answers(MEDIA_TYPES["json"]),
)
def get_report(job_id: str, request: Request, services: Needs) -> Response:
    """Parameters, seed, versions, timings and topology of the result, as JSON."""
    return _download(job_id, "report.json", request, services)


@router.head("/preview.png", include_in_schema=False)
@router.get(
    "/preview.png",
    operation_id="getPreview",
    summary="A picture of the mesh",
    response_class=Response,
    responses=_answers(MEDIA_TYPES["png"]),
)
def get_preview(job_id: str, request: Request, services: Needs) -> Response:
    """480 x 480 pixels, transparent around the mesh."""
    return _download(job_id, "preview.png", request, services)


def _download(job_id: str, name: str, request: Request, services: Services) -> Response:
    record = find_job(job_id, services)
    artifact = record.outputs.get(name)
    link = services.store.link_to(artifact) if artifact is not None else None
    if artifact is not None and link is not None:
        return redirected(request, link, sha256=artifact.sha256, size=artifact.bytes)
    found = result_file(record, name, services.store)
    media_type = MEDIA_TYPES[name.rpartition(".")[2]]
    return file_response(
        request, found.path, sha256=found.sha256, media_type=media_type, filename=found.filename
    )
