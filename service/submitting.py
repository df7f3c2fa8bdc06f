"""Queueing a job for a caller, and the answer that says so."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Header
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool

from jobs.errors import IdempotencyConflict, QueueFull, TooManyJobs, UnknownId
from jobs.records import Created, Idempotency
from jobs.spec import JobSpec
from jobs.submission import submit
from jobs.webhooks import refusal
from service.callers import current
from service.job_view import current_view, job_view
from service.problems import Problem, invalid
from service.room import require_room
from service.schemas import Job
from service.services import Services

POLL_AFTER = {"Retry-After": "1"}
IdempotencyKey = Annotated[str | None, Header(min_length=1, max_length=255)]


async def replayed(key: str | None, asked: Any, services: Services) -> JSONResponse | None:
    """The answer to a request that came before with the same key and values; None if it is new.

    Asked before anything is checked that may have changed meanwhile: the scan, quotas, the room.
    """
    known = _idempotency(key, asked)
    job_id = await services.looks.made_by(known) if known is not None else None
    look = await services.looks.look(job_id) if job_id is not None else None
    return None if look is None else _answer(job_view(look.record, look.queue_position), True)


async def accepted(spec: JobSpec, key: str | None, asked: Any, services: Services) -> JSONResponse:
    """Queues the job; 202 with its address.

    key: of the header Idempotency-Key; asked: JSON values that must be the same whenever the key
    comes again.

    Raises:
        Problem: the key was used otherwise, its job is gone, the queue or the disk is full.
    """
    require_room(services)
    await _count(services)
    created = await run_in_threadpool(_submitted, spec, key, asked, services)
    view = await run_in_threadpool(current_view, created.record, services.records)
    return _answer(view, created.replayed)


def _answer(view: Job, is_replay: bool) -> JSONResponse:
    headers = {"Location": f"/v1/jobs/{view.id}", **POLL_AFTER}
    if is_replay:
        headers["Idempotency-Replayed"] = "true"
    return JSONResponse(view.model_dump(mode="json"), 202, headers)


def _idempotency(key: str | None, asked: Any) -> Idempotency | None:
    """Keys of different callers have nothing to do with each other."""
    if key is None:
        return None
    owner = current().owner
    return Idempotency.of(key if owner is None else f"{owner}:{key}", asked)


async def _count(services: Services) -> None:
    """Raises a 429 when the caller's quota of the day is used up."""
    allowance = await services.rates.count_job(current())
    if allowance is not None and allowance.refused:
        limit = f"{allowance.limit} jobs a day"
        message = f"This key may make {limit}; ask again in {allowance.reset_s} s."
        headers = {"Retry-After": str(max(1, allowance.reset_s))}
        raise Problem("quota_exceeded", message, headers=headers)


def _submitted(spec: JobSpec, key: str | None, asked: Any, services: Services) -> Created:
    try:
        return submit(
            spec,
            services.records,
            services.store,
            services.dispatcher,
            idempotency=_idempotency(key, asked),
            queue_limit=services.settings.queue_limit,
            caller_limit=current().jobs,
        )
    except IdempotencyConflict as error:
        raise Problem("idempotency_conflict", str(error)) from error
    except UnknownId as error:
        raise Problem("gone", f"{error}; use a new Idempotency-Key.") from error
    except TooManyJobs as error:
        raise Problem("too_many_jobs", str(error), headers={"Retry-After": "30"}) from error
    except QueueFull as error:
        raise Problem("queue_full", str(error), headers={"Retry-After": "30"}) from error


def kept_for(ttl_s: float | None, services: Services) -> float:
    """How long a job is kept after its end, as asked or by default.

    Raises:
        Problem: 422, longer than this server keeps anything.
    """
    settings = services.settings
    if ttl_s is None:
        return settings.ttl_s
    if ttl_s > settings.max_ttl_s:
        most = f"{settings.max_ttl_s:g}"
        raise invalid("#/ttl_s", "invalid_value", f"ttl_s is {ttl_s:g}; choose up to {most}")
    return ttl_s


def callable_webhook(url: str | None, services: Services) -> str | None:
    """The address to tell of a job's states.

    Raises:
        Problem: 422, there are no webhooks here, or the address is none that may be called.
    """
    if url is None:
        return None
    if services.webhook_hosts is None:
        message = "webhooks are off here; follow the job's events, or set UDFLOW_WEBHOOK_SECRET"
        raise invalid("#/webhook", "webhooks_off", message)
    if (reason := refusal(url, services.webhook_hosts)) is not None:
        raise invalid("#/webhook", "invalid_value", f"this address cannot be called: {reason}")
    return url
