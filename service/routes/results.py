"""The files of a finished job as downloads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import Response

from jobs.spec import JobRecord
from service.downloads import file_response, redirected
from service.mesh_frames import Frame, local_copy, stated_shift
from service.openapi import Answers, problems
from service.problems import invalid
from service.results import ResultFile, result_file
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
_SINGLE_PRECISION = ("glb", "stl")
MeshFormat = Annotated[Literal["ply", "glb", "obj", "stl"], Query(description="file format")]
MeshFrame = Annotated[
    Frame | None,
    Query(description="world: as the scan; local: relative to a shift that the file states"),
]
Redirect = Annotated[
    bool, Query(description="false: the bytes themselves, also where results lie in a bucket")
]
Route = TypeVar("Route", bound=Callable[..., Response])
router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])


def _answers(*suffixes: str) -> Answers:
    content = {MEDIA_TYPES[suffix]: {"schema": _schema(suffix)} for suffix in suffixes}
    found: Answers = {
        200: {"content": content, "description": "The file"},
        206: {"content": content, "description": "The asked range of the file"},
        304: {"description": "The file is the one of If-None-Match"},
    }
    return found | problems(404, 409, 410, 416, 503)


def _schema(suffix: str) -> dict[str, str]:
    return {"type": "object"} if suffix == "json" else {"type": "string", "format": "binary"}


def _file(
    path: str, operation_id: str, summary: str, *suffixes: str, more: Answers | None = None
) -> Callable[[Route], Route]:
    """Declares a download: GET, and HEAD beside it."""

    def declared(endpoint: Route) -> Route:
        wish = [Depends(_note_redirect)]
        router.head(path, include_in_schema=False, dependencies=wish)(endpoint)
        return router.get(
            path,
            operation_id=operation_id,
            summary=summary,
            response_class=Response,
            responses=_answers(*suffixes) | (more or {}),
            dependencies=wish,
        )(endpoint)

    return declared


def _note_redirect(request: Request, redirect: Redirect = True) -> None:
    """Whether the caller can be sent to a bucket: a page in a browser may only load from here."""
    request.state.redirect = redirect


@_file("/mesh", "getMesh", "The mesh", "ply", "glb", "obj", "stl", more=problems(422))
def get_mesh(
    job_id: str,
    request: Request,
    services: Needs,
    format: MeshFormat = "ply",
    frame: MeshFrame = None,
) -> Response:
    """Triangles in the units of the scan.

    PLY and OBJ hold the coordinates of the scan in full. GLB and STL hold single precision: where
    that would tear large coordinates apart they are relative to a shift, which the file states.
    `frame=local` gives PLY and OBJ the same way; `frame=world` refuses a file that had to be
    shifted.
    """
    record = find_job(job_id, services)
    name = f"mesh.{format}"
    if frame == "local" and format not in _SINGLE_PRECISION:
        found = result_file(record, name, services.store)
        copy = local_copy(found.path)
        if copy != found.path:
            about = found.filename.rpartition(".")
            found = ResultFile(copy, f"{found.sha256}-local", f"{about[0]}-local.{about[2]}")
        return _sent(found, name, request)
    if frame == "world" and format in _SINGLE_PRECISION:
        _require_unshifted(result_file(record, name, services.store), format)
    return _download(record, name, request, services)


def _require_unshifted(found: ResultFile, format: str) -> None:
    """Raises a 422 if the file's coordinates are not the scan's."""
    if stated_shift(found.path) is not None:
        message = (
            f"{format.upper()} holds single precision, which is too coarse for these coordinates; "
            "take frame=local, whose shift the file states, or format=ply"
        )
        raise invalid("?frame", "invalid_value", message)


@_file("/points", "getPoints", "The densified cloud", "ply")
def get_points(job_id: str, request: Request, services: Needs) -> Response:
    """The scan's points and those added by densification, as PLY."""
    return _download(find_job(job_id, services), "points.ply", request, services)


@_file("/field", "getField", "The fitted field", "safetensors")
def get_field(job_id: str, request: Request, services: Needs) -> Response:
    """The field as safetensors, for `udflow query` and `udflow.fields.storage.load_field`."""
    return _download(find_job(job_id, services), "field.safetensors", request, services)


@_file("/report", "getReport", "The report", "json")
def get_report(job_id: str, request: Request, services: Needs) -> Response:
    """Parameters, seed, versions, timings and topology of the result, as JSON."""
    return _download(find_job(job_id, services), "report.json", request, services)


@_file("/preview.png", "getPreview", "A picture of the mesh", "png")
def get_preview(job_id: str, request: Request, services: Needs) -> Response:
    """480 x 480 pixels, transparent around the mesh."""
    return _download(find_job(job_id, services), "preview.png", request, services)


def _download(record: JobRecord, name: str, request: Request, services: Services) -> Response:
    artifact = record.outputs.get(name)
    may_leave: bool = request.state.redirect
    link = services.store.link_to(artifact) if artifact is not None and may_leave else None
    if artifact is not None and link is not None:
        return redirected(request, link, sha256=artifact.sha256, size=artifact.bytes)
    return _sent(result_file(record, name, services.store), name, request)


def _sent(found: ResultFile, name: str, request: Request) -> Response:
    media_type = MEDIA_TYPES[name.rpartition(".")[2]]
    return file_response(
        request, found.path, sha256=found.sha256, media_type=media_type, filename=found.filename
    )
