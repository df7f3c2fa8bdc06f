"""The events of a job: websocket, server-sent events or JSON pages, at one address."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing, suppress
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, WebSocket
from fastapi.responses import JSONResponse, Response, StreamingResponse
from redis.exceptions import RedisError
from starlette.websockets import WebSocketDisconnect

from jobs.errors import BadEventId
from jobs.events import START, require_event_id
from jobs.ids import is_id
from service.event_hub import Overflow
from service.event_message import Message
from service.event_stream import UnknownJob
from service.frames import FrameReader
from service.openapi import problems
from service.problems import invalid
from service.routes.jobs import find_snapshot
from service.schemas import EventPage
from service.services import Needs, Services
from service.tasks import end

ENDED, UNKNOWN, BAD_REQUEST, TRY_AGAIN = 1000, 4404, 4400, 1013
SEND_TIMEOUT_S = 20.0
SSE_HEADERS = {"Cache-Control": "no-cache", "X-Accel-Buffering": "no"}
EVENT_ID = r"^[0-9]{1,19}(-[0-9]{1,19})?$"
router = APIRouter(prefix="/v1/jobs", tags=["events"])


@router.websocket("/{job_id}/events")
async def watch_job(socket: WebSocket, job_id: str, services: Needs) -> None:
    """A snapshot, then every event with its id, until the end of the job (close code 1000).

    `?after=<id>` resumes after the last event seen. Silence is broken by a heartbeat each 15 s.
    `?previews=binary` adds frames of the growing cloud and of coarse meshes, as binary messages
    behind the events that announce them; `jobs/previews.py` has their layout.
    Other close codes: 4404 unknown job, 4400 malformed `after`, 1013 try again: the reader is too
    slow, or Redis is away.
    """
    await socket.accept()
    sending = asyncio.create_task(_send_events(socket, job_id, services))
    listening = asyncio.create_task(_until_disconnect(socket))
    try:
        await asyncio.wait({sending, listening}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await end(sending, listening)


async def _send_events(socket: WebSocket, job_id: str, services: Services) -> None:
    after = socket.query_params.get("after")
    try:
        if not is_id("job", job_id):
            raise UnknownJob
        reader = FrameReader(services.frames, job_id) if _wants_frames(socket) else None
        async with aclosing(services.events.stream(job_id, after)) as messages:
            async for message in messages:
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await socket.send_text(message.text)
                if reader is not None:
                    async for frame in reader.frames_for(message):
                        async with asyncio.timeout(SEND_TIMEOUT_S):
                            await socket.send_bytes(frame)
        await socket.close(ENDED, "the job has ended")
    except UnknownJob:
        await socket.close(UNKNOWN, "there is no job with this id")
    except BadEventId as error:
        await socket.close(BAD_REQUEST, str(error))
    except (Overflow, TimeoutError):
        await _turn_away(socket, "read faster, or resume with ?after=")
    except RedisError:
        await _turn_away(socket, "redis does not answer; resume with ?after= in a few seconds")
    except WebSocketDisconnect:
        return


def _wants_frames(socket: WebSocket) -> bool:
    return socket.query_params.get("previews") == "binary"


async def _turn_away(socket: WebSocket, reason: str) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await socket.close(TRY_AGAIN, reason)


async def _until_disconnect(socket: WebSocket) -> None:
    """Clients have nothing to say here; what they send is read and dropped."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


@router.get(
    "/{job_id}/events",
    operation_id="listJobEvents",
    summary="Events of a job as a page or a stream",
    response_model=EventPage,
    responses=problems(404, 410, 422, 503)
    | {200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def list_events(
    job_id: str,
    request: Request,
    services: Needs,
    after: Annotated[
        str | None, Query(description="id of the last event seen", pattern=EVENT_ID)
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 500,
    last_event_id: Annotated[str | None, Header(pattern=EVENT_ID)] = None,
) -> Response:
    """A page of events, or with `Accept: text/event-stream` a stream that lasts until the end.

    The same address speaks websocket.
    """
    await find_snapshot(job_id, services)
    resume = after or last_event_id
    _require_id(resume)
    if "text/event-stream" in request.headers.get("accept", ""):
        stream = _server_sent(services, job_id, resume)
        return StreamingResponse(stream, headers=SSE_HEADERS, media_type="text/event-stream")
    events, end = await services.events.page(job_id, resume or START, limit)
    return JSONResponse(
        {
            "events": [Message.of(event).values for event in events],
            "last_id": events[-1].id if events else resume or START,
            "end": end,
        }
    )


def _require_id(after: str | None) -> None:
    try:
        if after is not None:
            require_event_id(after)
    except BadEventId as error:
        raise invalid("?after", "invalid_value", str(error)) from error


async def _server_sent(services: Services, job_id: str, after: str | None) -> AsyncIterator[str]:
    try:
        async with aclosing(services.events.stream(job_id, after)) as messages:
            async for message in messages:
                yield message.frame
    except (UnknownJob, Overflow):
        return  # the connection ends; the browser comes back with Last-Event-ID
