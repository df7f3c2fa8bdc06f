"""Jobs: asking for a reconstruction, looking at it, stopping it."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import AwareDatetime, BeforeValidator
from starlette.concurrency import run_in_threadpool

from jobs.async_records import Look
from jobs.costs import Estimate
from jobs.ids import is_id
from jobs.spec import JobRecord, JobSpec, JobState
from service.bodies import read_model
from service.callers import current
from service.downloads import matches
from service.estimates import require_affordable, view
from service.ingest import is_form, received, store_scan
from service.job_request import complete_config, form_values, require_suitable
from service.job_view import current_view, job_view
from service.openapi import job_request_body, problems
from service.problems import Problem
from service.routes.scans import find_scan
from service.schemas import Job, JobCreate, JobEstimate, JobPage
from service.services import Needs, Services
from service.submitting import (
    POLL_AFTER,
    IdempotencyKey,
    accepted,
    callable_webhook,
    kept_for,
    replayed,
)

MAX_WAIT_S = 60.0


def _no_number(value: Any) -> Any:
    """Unix seconds would be read as a time otherwise."""
    if isinstance(value, str) and not value.partition("T")[2]:
        raise ValueError("give a time with its zone, such as 2026-11-22T17:00:00Z")
    return value


Moment = Annotated[AwareDatetime, BeforeValidator(_no_number)]
ID_PATTERN = "^job_[0-9a-hjkmnp-tv-z]{36}$"
router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


@router.post(
    "",
    operation_id="createJob",
    summary="Reconstruct a scan",
    status_code=202,
    response_model=Job,
    responses=problems(400, 404, 408, 410, 413, 415, 422, 429, 503, 507)
    | {200: {"model": JobEstimate, "description": "With `validate_only`: what it would take"}},
    openapi_extra={"requestBody": job_request_body()},
)
async def create_job(
    request: Request,
    services: Needs,
    idempotency_key: IdempotencyKey = None,
    validate_only: Annotated[bool, Query(description="estimate, and queue nothing")] = False,
) -> JSONResponse:
    """Queues a job for an uploaded scan (JSON), or uploads and queues in one go (form).

    With an `Idempotency-Key` a repeated request is harmless: the first job comes back. With
    `validate_only` nothing is queued, and the answer says what the job would take.
    """
    if is_form(request):
        wish = await _wish_with_file(request, services)
    else:
        wish = await read_model(request, JobCreate)
        # before the scan is looked for: a wrong parameter is told even if the id is wrong too
        complete_config(wish.preset, wish.config)
    asked = wish.model_dump(mode="json")
    if not validate_only and (again := await replayed(idempotency_key, asked, services)):
        return again
    scan = await run_in_threadpool(_scan_of, wish.scan_id, services)
    spec = JobSpec.new(
        wish.scan_id,
        complete_config(wish.preset, wish.config),
        dict(wish.metadata),
        kept_for(wish.ttl_s, services),
        wanted=tuple(wish.outputs),
        webhook=callable_webhook(wish.webhook, services),
        caller=current().owner,
    )
    require_suitable(spec.config, scan)
    estimate = await run_in_threadpool(
        require_affordable, scan, spec.config, "reconstruct", services
    )
    if validate_only:
        return await run_in_threadpool(_estimate, spec, estimate, services)
    return await accepted(spec, idempotency_key, asked, services)


def _estimate(spec: JobSpec, estimate: Estimate, services: Services) -> JSONResponse:
    found = JobEstimate(
        scan_id=spec.scan_id,
        config=spec.config,
        estimate=view(estimate),
        jobs_ahead=services.records.queue_length(),
    )
    return JSONResponse(found.model_dump(mode="json"))


async def _wish_with_file(request: Request, services: Services) -> JobCreate:
    async with received(request, services) as (upload, form):
        wish = form_values(form.fields)
        complete_config(wish.preset, wish.config)
        manifest, _ = await store_scan(upload, form, services)
    return wish.model_copy(update={"scan_id": manifest["id"]})


def _scan_of(scan_id: str, services: Services) -> dict[str, Any]:
    try:
        return find_scan(scan_id, services)
    except Problem as problem:
        problem.errors = (("#/scan_id", problem.code, problem.detail),)
        raise


@router.get(
    "",
    operation_id="listJobs",
    summary="Jobs, the newest first",
    response_model=JobPage,
    responses=problems(422, 503),
)
def list_jobs(
    services: Needs,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[
        str | None, Query(description="`next_cursor` of the page before", pattern=ID_PATTERN)
    ] = None,
    state: JobState | None = None,
    scan_id: str | None = None,
    created_after: Moment | None = None,
) -> JobPage:
    """One page of jobs; ask for the next with `cursor`."""
    after = None if created_after is None else created_after.timestamp()
    page = services.records.page(
        limit,
        cursor,
        state=state,
        scan_id=scan_id,
        created_after=after,
        of=current().owner,
    )
    jobs = [current_view(record, services.records) for record in page.records]
    return JobPage(jobs=jobs, next_cursor=page.next)


@router.get(
    "/{job_id}",
    operation_id="getJob",
    summary="The state of a job",
    response_model=Job,
    responses=problems(404, 410, 422, 503)
    | {304: {"description": "Nothing changed since the ETag of If-None-Match"}},
)
async def get_job(
    job_id: str,
    request: Request,
    services: Needs,
    wait: Annotated[float, Query(ge=0, le=MAX_WAIT_S, description="seconds to wait")] = 0.0,
) -> Response:
    """The job as it is now.

    With `wait`, the answer comes when the job has ended, or after so many seconds; together with
    `If-None-Match`, as soon as anything has changed.
    """
    known = request.headers.get("if-none-match")
    snapshot = await find_snapshot(job_id, services)
    body, etag = _tagged(snapshot)
    settled = snapshot.record.is_terminal or (known is not None and not matches(known, etag))
    if wait > 0 and not settled:
        await services.events.wait_for_change(job_id, snapshot, wait, to_end=known is None)
        snapshot = await find_snapshot(job_id, services)
        body, etag = _tagged(snapshot)
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    if matches(known, etag):
        return Response(status_code=304, headers=headers)
    if not snapshot.record.is_terminal:
        headers |= POLL_AFTER
    return Response(body, headers=headers, media_type="application/json")


def _tagged(snapshot: Look) -> tuple[bytes, str]:
    """The job as JSON, and its ETag."""
    body = job_view(snapshot.record, snapshot.queue_position).model_dump_json().encode()
    return body, f'"{hashlib.sha256(body).hexdigest()[:32]}"'


def find_job(job_id: str, services: Services) -> JobRecord:
    """The record of a job.

    Raises:
        Problem: 404, or 410 if it was there once.
    """
    known = is_id("job", job_id)
    record = services.records.get(job_id) if known else None
    if record is None or not current().sees(record.caller):
        raise _unknown_job(known and services.records.is_gone(job_id))
    return record


async def find_snapshot(job_id: str, services: Services) -> Look:
    """The record of a job and its place among its events; raises as `find_job`."""
    gone = False
    if is_id("job", job_id):
        snapshot = await services.looks.look(job_id)
        if snapshot is not None and current().sees(snapshot.record.caller):
            return snapshot
        gone = await services.looks.is_gone(job_id)
    raise _unknown_job(gone)


def _unknown_job(gone: bool) -> Problem:
    """404, or 410 if there was such a job once."""
    if gone:
        return Problem("gone", "This job was deleted or has expired, with all its files.")
    return Problem("job_not_found", "There is no job with this id; GET /v1/jobs lists all jobs.")
