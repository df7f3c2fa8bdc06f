"""Distances: asking the fitted field at any points, many at once."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response, StreamingResponse
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from service import udf_input, udf_output
from service.bodies import spool
from service.field_cache import FieldCache
from service.openapi import problems, udf_answers, udf_request_body
from service.problems import Problem
from service.results import ResultFile, result_file
from service.routes.jobs import find_snapshot
from service.services import Needs
from service.udf_input import Question, Wanted, Wire, read_question
from service.udf_output import MEDIA_TYPES
from udflow.errors import BadField, OutdatedField

if TYPE_CHECKING:
    from udflow.fields.unsigned import FieldAnswer, UnsignedDistanceField

CHUNK = 1 << 17
Flag = Annotated[bool, Query()]
router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["distances"])


@router.post(
    "/udf",
    operation_id="queryDistances",
    summary="Unsigned distances at points",
    response_class=Response,
    responses=udf_answers() | problems(400, 404, 409, 410, 413, 422, 503, 507),
    openapi_extra={"requestBody": udf_request_body()},
)
async def query_distances(
    job_id: str,
    request: Request,
    services: Needs,
    gradients: Flag = False,
    closest: Flag = False,
    valid: Flag = False,
    dtype: Annotated[Literal["float32", "float64"] | None, Query()] = None,
) -> Response:
    """The distance to the surface at each point, in the units and frame of the scan.

    JSON takes up to 100 000 points. A `.npy` array of shape (n, 3) takes up to 16 million and is
    answered by a `.npy` array: (n,) distances, or records with the fields `distance`, `gradient`,
    `closest`, `valid` when `gradients`, `closest` or `valid` is asked for. Bare little-endian
    numbers go the same way with `?dtype=float32` or `float64`. `Accept` chooses another form.
    """
    record = (await find_snapshot(job_id, services)).record
    stored = await run_in_threadpool(result_file, record, "field.safetensors", services.store)
    wanted = Wanted(gradients, closest, valid)
    async with AsyncExitStack() as held:
        file = held.enter_context(_unlinked(services.store.root / "incoming"))
        size = await spool(request, udf_input.MAX_BINARY_BYTES, file)
        read = partial(read_question, file, size, request.headers, dtype, wanted)
        question = await services.fields.run(read)
        field = await load_stored(stored, services.fields)
        wire = _reply_wire(request, question)
        if wire == "json":
            body = await services.fields.run(partial(_json, field, question))
            return Response(body, media_type=MEDIA_TYPES["json"])
        return _Streamed(question, wire, field, services.fields, held.pop_all())


@contextmanager
def _unlinked(folder: Path) -> Iterator[BinaryIO]:
    """A file without a name: whatever happens, nothing of it stays."""
    with tempfile.TemporaryFile(dir=folder) as file:
        yield file


async def load_stored(stored: ResultFile, fields: FieldCache) -> UnsignedDistanceField:
    """The field in a result file.

    Raises:
        Problem: 409, another release stored it; 500, it is damaged.
    """
    try:
        return await fields.get(stored.path)
    except OutdatedField as error:
        raise Problem("outdated_field", f"{error}: make a new job of its scan.") from error
    except BadField as error:
        raise Problem("artifact_damaged", str(error)) from error


def _reply_wire(request: Request, question: Question) -> Wire:
    """The form that Accept names, else the form of the question."""
    accepted = request.headers.get("accept", "")
    named = [wire for wire, media_type in MEDIA_TYPES.items() if media_type in accepted]
    wire = question.wire if question.wire in named or not named else named[0]
    if wire == "json" and len(question.points) > udf_input.JSON_POINTS:
        limit = udf_input.JSON_POINTS
        raise Problem("body_too_large", f"JSON answers at most {limit} points; accept .npy.")
    return wire


def _ask(field: UnsignedDistanceField, points: NDArray[Any]) -> FieldAnswer:
    return field.query(np.ascontiguousarray(points, np.float64))


def _json(field: UnsignedDistanceField, question: Question) -> bytes:
    return udf_output.json_answer(_ask(field, question.points), question.wanted)


class _Streamed(StreamingResponse):
    """Answers chunk by chunk; holds the query points until the last one, or the client, is gone."""

    def __init__(
        self,
        question: Question,
        wire: Wire,
        field: UnsignedDistanceField,
        fields: FieldCache,
        held: AsyncExitStack,
    ) -> None:
        points, rows = question.points, len(question.points)
        stream = udf_output.stream_for(wire, question.wanted, points.dtype)

        async def body() -> AsyncIterator[bytes]:
            yield stream.head(rows)
            for start in range(0, rows, CHUNK):
                answer = await fields.run(partial(_ask, field, points[start : start + CHUNK]))
                yield await fields.run(partial(stream.rows, answer))

        headers = stream.headers(rows) | {"Content-Length": str(stream.length(rows))}
        super().__init__(body(), headers=headers, media_type=MEDIA_TYPES[wire])
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with self._held:
            await super().__call__(scope, receive, send)
