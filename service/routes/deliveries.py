"""What became of a job's webhooks, and sending one again."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool

from jobs.spec import JobRecord, JobState
from jobs.webhooks import Delivery, WebhookQueue, event_type
from service.bodies import read_model
from service.job_view import moment
from service.openapi import model_body, problems
from service.problems import invalid
from service.requests import Redelivery
from service.routes.jobs import find_job
from service.schemas import DeliveryList, DeliveryState
from service.services import Needs, Services

router = APIRouter(prefix="/v1/jobs/{job_id}/deliveries", tags=["jobs"])


@router.get(
    "",
    operation_id="listDeliveries",
    summary="What became of the webhooks",
    response_model=DeliveryList,
    responses=problems(404, 410, 503),
)
def list_deliveries(job_id: str, services: Needs) -> DeliveryList:
    """The last tries to call the job's webhook, newest first."""
    find_job(job_id, services)
    return _listed(job_id, services)


@router.post(
    "",
    operation_id="redeliver",
    summary="Call the webhook again",
    status_code=202,
    response_model=DeliveryList,
    responses=problems(400, 404, 410, 422, 503),
    openapi_extra={"requestBody": model_body("Redelivery", required=False)},
)
async def redeliver(job_id: str, request: Request, services: Needs) -> DeliveryList:
    """Sends an event once more, delivered before or given up, with all its tries ahead of it.

    Without a body it is the last that happened. The message keeps its `webhook-id`, so that a
    receiver who has it already can tell.
    """
    record = await run_in_threadpool(find_job, job_id, services)
    wish = await read_model(request, Redelivery, optional=True)
    state = _state_told(record, wish.event)
    await run_in_threadpool(WebhookQueue(services.redis).send_again, job_id, state)
    return await run_in_threadpool(_listed, job_id, services)


def _state_told(record: JobRecord, event: str | None) -> JobState:
    """The state whose event is to be sent.

    Raises:
        Problem: 422, the job has no webhook, or the event has not happened.
    """
    if record.webhook is None:
        raise invalid("#", "no_webhook", "this job was made without a webhook; there is no address")
    happened = {event_type(state): state for state in _reached(record)}
    found = happened.get(event) if event else next(reversed(happened.values()), None)
    if found is None:
        told = ", ".join(happened) or "none yet"
        raise invalid("#/event", "invalid_value", f"this has not happened; what has: {told}")
    return found


def _reached(record: JobRecord) -> list[JobState]:
    """The states that webhooks tell of and that the job has come to, in their order."""
    started = [JobState.RUNNING] if record.started_at is not None else []
    return started + ([record.state] if record.is_terminal else [])


def _listed(job_id: str, services: Services) -> DeliveryList:
    found = WebhookQueue(services.redis).deliveries(job_id)
    return DeliveryList(deliveries=[_view(one) for one in found])


def _view(one: Delivery) -> DeliveryState:
    times = {"time": moment(one.time), "next_at": one.next_at and moment(one.next_at)}
    return DeliveryState(**asdict(one) | times)
