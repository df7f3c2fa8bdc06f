"""Planes through the fitted field: distances as an array, or as a picture with isolines."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

from service.bodies import read_model, validated
from service.openapi import Answers, model_body, problems
from service.problems import Problem
from service.requests import MAX_SLICE, Slice
from service.results import result_file
from service.routes.jobs import find_snapshot
from service.routes.udf import load_stored
from service.services import Needs, Services
from service.slices import Plane, picture, plane_of
from udflow.png import png

if TYPE_CHECKING:
    from udflow.fields.unsigned import UnsignedDistanceField

ROWS_AT_ONCE = 1 << 17  # cells asked for in one go, so that short questions get between
ROOM = 0.15  # of the scan's largest extent, shown around it
MEDIA_TYPES = {"npy": "application/x-npy", "png": "image/png"}
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_ANSWERS: Answers = {
    200: {
        "description": "Distances (rows, columns), float32, row 0 at the top; or their picture",
        "content": dict.fromkeys(MEDIA_TYPES.values(), _BINARY),
    }
}
router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["distances"])


@router.post(
    "/udf/slice",
    operation_id="querySlice",
    summary="Distances on a plane",
    response_class=Response,
    responses=_ANSWERS | problems(400, 404, 409, 410, 413, 422, 503),
    openapi_extra={"requestBody": model_body("Slice")},
)
async def query_slice(job_id: str, request: Request, services: Needs) -> Response:
    """A grid of distances as `.npy`, or a PNG with a colour map and isolines.

    Headers say where the cells lie: `X-Slice-First` is the centre of the top left cell,
    `X-Slice-Right` and `X-Slice-Down` lead to the next cell of a row and of a column.
    """
    return await _sliced(job_id, await read_model(request, Slice), services)


@router.get(
    "/udf/slice",
    operation_id="getSlice",
    summary="Distances on a plane, by address",
    response_class=Response,
    responses=_ANSWERS | problems(404, 409, 410, 422, 503),
)
async def get_slice(
    job_id: str,
    services: Needs,
    axis: Literal["x", "y", "z"] | None = None,
    at: Annotated[float | None, Query(allow_inf_nan=False)] = None,
    resolution: Annotated[int, Query(ge=2, le=MAX_SLICE)] = 256,
    format: Literal["npy", "png"] = "png",
    isolines: Annotated[bool, Query(description="lines of equal distance in the picture")] = True,
) -> Response:
    """As the POST, for planes across an axis: an address that an `<img>` can show."""
    values = {"axis": axis, "at": at, "resolution": resolution, "format": format}
    return await _sliced(job_id, _from_query({**values, "isolines": isolines}), services)


def _from_query(values: dict[str, Any]) -> Slice:
    try:
        return validated(Slice, values)
    except Problem as problem:
        errors = [(f"?{p[2:]}", code, message) for p, code, message in problem.errors]
        detail = "; ".join(message for _, _, message in errors)
        raise Problem("invalid_request", detail, errors=errors) from problem


async def _sliced(job_id: str, wish: Slice, services: Services) -> Response:
    record = (await find_snapshot(job_id, services)).record
    stored = await run_in_threadpool(result_file, record, "field.safetensors", services.store)
    field = await load_stored(stored, services.fields)
    scan = await run_in_threadpool(services.store.read_scan, record.scan_id)
    plane = plane_of(wish, *_surroundings(scan, field))
    points = plane.points()
    parts = []
    for start in range(0, len(points), ROWS_AT_ONCE):
        piece = points[start : start + ROWS_AT_ONCE]
        parts.append((await services.fields.run(partial(field.query, piece))).distance)
    distance = np.concatenate(parts).reshape(plane.rows, plane.columns)
    body, more = await services.fields.run(partial(_encoded, distance, plane, wish))
    headers = _where(plane) | more | {"Cache-Control": "private, max-age=3600"}
    return Response(body, headers=headers, media_type=MEDIA_TYPES[wish.format])


def _surroundings(
    scan: dict[str, Any] | None, field: UnsignedDistanceField
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The corners of what a slice shows if not told: the scan with some room around it; the much
    larger box of the field when the scan was deleted."""
    if scan is None:
        return field.low, field.high
    low, high = np.asarray(scan["low"]), np.asarray(scan["high"])
    room = ROOM * float((high - low).max())
    return low - room, high + room


def _encoded(
    distance: NDArray[np.float64], plane: Plane, wish: Slice
) -> tuple[bytes, dict[str, str]]:
    if wish.format == "npy":
        file = io.BytesIO()
        np.save(file, distance.astype(np.float32), allow_pickle=False)
        return file.getvalue(), {}
    image, step = picture(distance, plane.cell, wish.isolines)
    scale = {"X-Isoline-Step": f"{step:g}", "X-Largest-Distance": f"{distance.max():.6g}"}
    return png(image), scale


def _where(plane: Plane) -> dict[str, str]:
    vectors = {"First": plane.first, "Right": plane.right, "Down": plane.down}
    return {
        f"X-Slice-{name}": ",".join(repr(float(x)) for x in vector)
        for name, vector in vectors.items()
    }
