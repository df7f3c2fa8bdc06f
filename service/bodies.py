"""Request bodies, read with a limit and never held twice."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any, BinaryIO, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json
from starlette.concurrency import run_in_threadpool

from service.problems import Problem, from_validation

M = TypeVar("M", bound=BaseModel)
BUFFER_BYTES = 1 << 20
MAX_JSON_BYTES = 1 << 20


async def limited(request: Request, limit: int) -> AsyncIterator[bytes]:
    """The chunks of the body.

    Raises:
        Problem: the body is longer than `limit` bytes, announced or not, or is compressed.
    """
    if request.headers.get("content-encoding", "identity").lower() != "identity":
        raise Problem("unsupported_media_type", "Send the body without Content-Encoding.")
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > limit:
        raise _too_large(limit)
    total = 0
    async for chunk in request.stream():
        total += len(chunk)
        if total > limit:
            raise _too_large(limit)
        if chunk:
            yield chunk


def _too_large(limit: int) -> Problem:
    return Problem(
        "body_too_large",
        f"The body is larger than the {limit} bytes taken here.",
        headers={"Connection": "close"},
        limit_bytes=limit,
    )


async def read_all(request: Request, limit: int) -> bytes:
    """The whole body, at most `limit` bytes."""
    return b"".join([chunk async for chunk in limited(request, limit)])


async def spool(request: Request, limit: int, file: BinaryIO) -> int:
    """Writes the body to a file off the event loop; returns its length in bytes."""
    total = 0
    async for block in in_blocks(limited(request, limit)):
        await run_in_threadpool(file.write, block)
        total += len(block)
    await run_in_threadpool(file.flush)
    return total


async def in_blocks(chunks: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """The same bytes in blocks of about a megabyte, worth a trip to another thread each."""
    buffer = bytearray()
    async for chunk in chunks:
        buffer += chunk
        if len(buffer) >= BUFFER_BYTES:
            yield bytes(buffer)
            buffer.clear()
    if buffer:
        yield bytes(buffer)


async def read_model(request: Request, model: type[M], *, optional: bool = False) -> M:
    """The JSON body as a checked object. optional: no body stands for an empty object.

    Raises:
        Problem: not JSON, or values that the model refuses.
    """
    data = await read_all(request, MAX_JSON_BYTES)
    return validated(model, {} if optional and not data.strip() else parse_json(data))


def parse_json(data: bytes | str) -> Any:
    """JSON values; NaN and Infinity are no JSON."""
    try:
        return from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise Problem("malformed_request", f"The body is not valid JSON: {error}.") from error


def validated(model: type[M], values: Any) -> M:
    """The values as a checked object.

    Raises:
        Problem: 422 with a pointer to each value that is wrong.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise from_validation(error.errors(include_input=False, include_url=False)) from error
