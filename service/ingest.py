"""A scan on its way in: body to disk, sha256 on the way, inspection in a child, store."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from email.message import Message
from typing import Any

from fastapi import Request
from starlette.concurrency import run_in_threadpool

from jobs.store import Upload
from service.bodies import BUFFER_BYTES, in_blocks, limited
from service.callers import current
from service.multipart import Form, read_form
from service.names import clean_filename
from service.problems import Problem, invalid
from service.room import require_room
from service.services import Services

FORM_OVERHEAD = 1 << 20


def is_form(request: Request) -> bool:
    """Whether the body is multipart/form-data."""
    return request.headers.get("content-type", "").lower().startswith("multipart/form-data")


@asynccontextmanager
async def received(request: Request, services: Services) -> AsyncIterator[tuple[Upload, Form]]:
    """The bytes of the file on disk and what came with them; removed again unless stored.

    Raises:
        Problem: too large, malformed, interrupted or without a file; no room for it.
    """
    require_room(services, _announced(request))
    with services.store.receive() as upload:
        if is_form(request):
            form = await _receive_form(request, services, upload)
        else:
            form = Form(filename=_raw_filename(request))
            async for block in in_blocks(limited(request, services.settings.max_upload_bytes)):
                await run_in_threadpool(upload.write, block)
        if upload.size == 0:
            raise Problem("invalid_cloud", "The file is empty: it has 0 bytes. Send a point cloud.")
        yield upload, form


def _announced(request: Request) -> int:
    length = request.headers.get("content-length", "")
    return int(length) if length.isascii() and length.isdigit() and len(length) < 19 else 0


async def store_scan(upload: Upload, form: Form, services: Services) -> tuple[dict[str, Any], bool]:
    """The manifest of the scan with these bytes, and whether it is new.

    Raises:
        Problem: 415 or 422 when no mesh can be made of it.
    """
    digest = await run_in_threadpool(upload.close)
    owner = current().owner
    known = await run_in_threadpool(services.store.find_scan, digest, owner)
    stored = await run_in_threadpool(services.store.read_scan, known) if known else None
    if stored is not None:
        return stored, False
    summary = await services.inspector.inspect(upload.path)
    name = clean_filename(form.filename or "")
    manifest = {**summary, "filename": name, "caller": owner}
    added = await run_in_threadpool(services.store.add_scan, upload, manifest)
    stored = await run_in_threadpool(services.store.read_scan, added.id)
    if stored is None:
        raise Problem("gone", "The scan was deleted as soon as it was there; send it again.")
    return stored, added.created


async def _receive_form(request: Request, services: Services, upload: Upload) -> Form:
    buffer = bytearray()

    async def write(piece: bytes) -> None:
        buffer.extend(piece)
        if len(buffer) >= BUFFER_BYTES:
            await run_in_threadpool(upload.write, bytes(buffer))
            buffer.clear()

    limit = services.settings.max_upload_bytes + FORM_OVERHEAD
    form = await read_form(request.headers["content-type"], limited(request, limit), write)
    await run_in_threadpool(upload.write, bytes(buffer))
    if form.filename is None:
        raise invalid("#/file", "missing", 'the form has no file; send the scan in the part "file"')
    return form


def _raw_filename(request: Request) -> str:
    if name := request.query_params.get("filename"):
        return name
    header = Message()
    # headers arrive as latin-1; a plain filename in UTF-8 is what most clients mean
    sent = request.headers.get("content-disposition", "")
    header["content-disposition"] = sent.encode("latin-1").decode("utf-8", "replace")
    return header.get_filename() or ""
