"""What can be done with a job that exists: stop it, repeat it, extract again, delete it."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool

from jobs.spec import JobRecord, JobSpec, JobState
from service.bodies import read_model
from service.callers import current
from service.estimates import require_affordable
from service.job_view import current_view
from service.openapi import model_body, problems
from service.problems import Problem
from service.requests import Cancel, Extraction
from service.results import result_file
from service.routes.jobs import find_job
from service.routes.scans import Force, find_scan
from service.schemas import Job
from service.services import Needs, Services
from service.submitting import IdempotencyKey, accepted, kept_for, replayed

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["jobs"])


@router.post(
    "/cancel",
    operation_id="cancelJob",
    summary="Stop a job",
    status_code=202,
    response_model=Job,
    responses=problems(400, 404, 409, 410, 422, 503),
    openapi_extra={"requestBody": model_body("Cancel", required=False)},
)
async def cancel_job(job_id: str, request: Request, services: Needs) -> Job:
    """A waiting job is canceled at once, a running one becomes `canceling` and then `canceled`.

    With `keep_partial` a mesh is made of what is fitted by then, and the canceled job has its
    files. Asking again changes nothing, except that asking without `keep_partial` gives them up.
    A job that ended otherwise answers 409 with its state.
    """
    await run_in_threadpool(find_job, job_id, services)  # a wrong id is told before a wrong body
    wish = await read_model(request, Cancel, optional=True)
    return await run_in_threadpool(_cancel, job_id, wish.keep_partial, services)


def _cancel(job_id: str, keep_partial: bool, services: Services) -> Job:
    record = find_job(job_id, services)
    record = services.records.request_cancel(job_id, keep_partial=keep_partial) or record
    if record.is_terminal and record.state is not JobState.CANCELED:
        raise Problem(
            "job_finished",
            f"The job has {record.state} already; there is nothing left to cancel.",
            state=record.state,
        )
    if record.state is JobState.CANCELED:
        services.dispatcher.withdraw(record.id, record.attempt)
    return current_view(record, services.records)


@router.post(
    "/retry",
    operation_id="retryJob",
    summary="The same job again",
    status_code=202,
    response_model=Job,
    responses=problems(404, 409, 410, 422, 429, 503, 507),
)
async def retry_job(
    job_id: str, services: Needs, idempotency_key: IdempotencyKey = None
) -> JSONResponse:
    """A new job with the scan, the parameters and the metadata of one that has ended."""
    asked = {"retry": job_id}
    if again := await replayed(idempotency_key, asked, services):
        return again
    record = await run_in_threadpool(find_job, job_id, services)
    _require_ended(record)
    await run_in_threadpool(find_scan, record.scan_id, services)
    spec = JobSpec.new(
        record.scan_id,
        record.config,
        record.metadata,
        record.ttl_s,
        kind=record.kind,
        source=record.source,
        box=record.box,
        wanted=record.wanted,
        retried_from=record.id,
        webhook=record.webhook,
        caller=current().owner,
    )
    return await accepted(spec, idempotency_key, asked, services)


@router.post(
    "/extract",
    operation_id="extractAgain",
    summary="Another mesh from the same field",
    status_code=202,
    response_model=Job,
    responses=problems(400, 404, 409, 410, 422, 429, 503, 507),
    openapi_extra={"requestBody": model_body("Extraction", required=False)},
)
async def extract_again(
    job_id: str, request: Request, services: Needs, idempotency_key: IdempotencyKey = None
) -> JSONResponse:
    """A short job that fits nothing: another resolution, or the part inside a box."""
    record = await run_in_threadpool(_fitted, job_id, services)
    wish = await read_model(request, Extraction, optional=True)
    asked: dict[str, Any] = {"extract": record.id, **wish.model_dump(mode="json")}
    if again := await replayed(idempotency_key, asked, services):
        return again
    changes = {"resolution": wish.resolution, "extractor": wish.extractor}
    given = {name: value for name, value in changes.items() if value is not None}
    spec = JobSpec.new(
        record.scan_id,
        record.config | {"extract": record.config["extract"] | given},
        dict(wish.metadata),
        kept_for(wish.ttl_s, services),
        kind="extract",
        source=record.id,
        box=(wish.box.low, wish.box.high) if wish.box else None,
        wanted=tuple(wish.outputs),
        caller=current().owner,
    )
    scan = await run_in_threadpool(services.store.read_scan, record.scan_id) or {}
    await run_in_threadpool(require_affordable, scan, spec.config, "extract", services)
    return await accepted(spec, idempotency_key, asked, services)


def _fitted(job_id: str, services: Services) -> JobRecord:
    """The job whose field is to be used: itself, or the one it was extracted from."""
    record = find_job(job_id, services)
    if record.kind == "extract" and record.source is not None:
        record = find_job(record.source, services)
    for name in ("field.safetensors", "points.ply"):
        result_file(record, name, services.store)
    return record


@router.delete(
    "",
    operation_id="deleteJob",
    summary="Delete a job",
    status_code=204,
    responses=problems(404, 409, 503),
)
def delete_job(job_id: str, services: Needs, force: Force = False) -> None:
    """Removes the job, its events and all its files; deleting again changes nothing.

    While it waits or runs the answer is 409, unless `force` is given: it is stopped at once.
    """
    try:
        record = find_job(job_id, services)
    except Problem as problem:
        if problem.code == "gone":
            return
        raise
    if not services.records.delete(job_id, force):
        _require_ended(services.records.get(job_id) or record)
    if not record.is_terminal:
        services.dispatcher.withdraw(record.id, record.attempt)
        services.dispatcher.stop(record.id, record.attempt)
    services.store.delete_job(job_id)


def _require_ended(record: JobRecord) -> None:
    if not record.is_terminal:
        raise Problem(
            "job_not_finished",
            f"The job is {record.state}; cancel it first, or add ?force=true to delete it.",
            state=record.state,
            progress=record.progress,
        )
