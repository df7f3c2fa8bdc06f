"""Scans: uploaded point clouds."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool

from jobs.errors import UnknownId
from service.callers import current
from service.ingest import received, store_scan
from service.job_view import moment
from service.openapi import FILE_FORM, RAW_BODY, problems
from service.problems import Problem, invalid
from service.schemas import Scan
from service.services import Needs, Services

Force = Annotated[bool, Query(description="even while it is used")]
router = APIRouter(prefix="/v1/scans", tags=["scans"])


@router.post(
    "",
    operation_id="createScan",
    summary="Upload a scan",
    status_code=201,
    response_model=Scan,
    responses=problems(400, 408, 413, 415, 422, 507)
    | {200: {"model": Scan, "description": "The same bytes were uploaded before"}},
    openapi_extra={"requestBody": {"required": True, "content": FILE_FORM | RAW_BODY}},
)
async def create_scan(request: Request, services: Needs) -> JSONResponse:
    """Sends a point cloud as the form part `file`, or as the bare body.

    The format is told from the content, not from the name. The same bytes again give the same
    scan with 200.
    """
    async with received(request, services) as (upload, form):
        if form.fields:
            name = next(iter(form.fields))
            raise invalid(f"#/{name}", "unknown_key", f'unknown part "{name}"; send only "file"')
        manifest, created = await store_scan(upload, form, services)
    headers = {"Location": f"/v1/scans/{manifest['id']}"}
    view = scan_view(manifest).model_dump(mode="json")
    return JSONResponse(view, 201 if created else 200, headers)


@router.delete(
    "/{scan_id}",
    operation_id="deleteScan",
    summary="Delete a scan",
    status_code=204,
    responses=problems(404, 409, 503),
)
def delete_scan(scan_id: str, services: Needs, force: Force = False) -> None:
    """Removes the bytes of a scan; deleting again changes nothing.

    While jobs for it wait or run the answer is 409, unless `force` is given: they are canceled.
    """
    try:
        find_scan(scan_id, services)
    except Problem as problem:
        if problem.code == "gone":
            return
        raise
    users = services.records.unfinished_with(scan_id)
    if users and not force:
        raise Problem(
            "scan_in_use",
            f"{len(users)} jobs for this scan wait or run; cancel them, or add ?force=true.",
            jobs=users[:20],
        )
    for job_id in users:
        services.records.request_cancel(job_id)
    services.records.mark_gone(scan_id)
    services.store.delete_scan(scan_id)


@router.get(
    "/{scan_id}",
    operation_id="getScan",
    summary="What is known about a scan",
    response_model=Scan,
    responses=problems(404, 410),
)
async def get_scan(scan_id: str, services: Needs) -> Scan:
    """The scan's size, format, bounds, spacing and noise."""
    return scan_view(await run_in_threadpool(find_scan, scan_id, services))


def find_scan(scan_id: str, services: Services) -> dict[str, Any]:
    """The manifest of a scan.

    Raises:
        Problem: 404, or 410 if it was there once.
    """
    try:
        manifest = services.store.read_scan(scan_id)
    except UnknownId as error:
        raise Problem("scan_not_found", str(error)) from error
    if manifest is not None and current().sees(manifest.get("caller")):
        return manifest
    if services.records.is_gone(scan_id):
        raise Problem("gone", "This scan was deleted or has expired; upload it again.")
    raise Problem("scan_not_found", "There is no scan with this id; upload it by POST /v1/scans.")


def scan_view(manifest: dict[str, Any]) -> Scan:
    """A manifest as the API shows it."""
    own = f"/v1/scans/{manifest['id']}"
    links = {"self": own, "jobs": f"/v1/jobs?scan_id={manifest['id']}"}
    return Scan(**{**manifest, "created_at": moment(manifest["created_at"]), "links": links})
