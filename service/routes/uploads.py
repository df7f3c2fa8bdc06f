"""Resumable uploads by the tus protocol; a finished one is a scan."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, BinaryIO

from fastapi import APIRouter, Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from jobs.store import Upload
from jobs.uploads import UploadBusy, UploadInfo
from service.bodies import BUFFER_BYTES, limited
from service.callers import current
from service.ingest import store_scan
from service.job_view import moment
from service.multipart import Form
from service.names import clean_filename
from service.openapi import Answers, problems
from service.problems import Problem
from service.room import require_room
from service.routes.scans import find_scan, scan_view
from service.schemas import JobFailure, UploadState
from service.services import Needs, Services
from service.tus import (
    CHUNK_TYPE,
    EXTENSIONS,
    RESUMABLE,
    VERSION,
    filename_of,
    header_number,
    headers_of,
    require_version,
)

_SETTLING = ("unknown_format", "invalid_cloud", "scan_too_costly")  # no use in trying again
_CHUNK: dict[str, Any] = {
    "requestBody": {
        "content": {CHUNK_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
_TUS: list[dict[str, Any]] = [
    {"name": "Tus-Resumable", "in": "header", "required": True, "schema": {"const": VERSION}}
]
_NUMBER = {"type": "integer", "minimum": 0}


def _parameters(*names: str) -> list[dict[str, Any]]:
    return _TUS + [
        {"name": name, "in": "header", "required": True, "schema": _NUMBER} for name in names
    ]


_EMPTY: Answers = {204: {"description": "`Upload-Offset` says how far the upload is"}}
_OFFSET: Answers = {200: {"description": "`Upload-Offset` and `Upload-Length`"}}
router = APIRouter(prefix="/v1/uploads", tags=["uploads"])


@router.options("", include_in_schema=False)
def describe_uploads(services: Needs) -> Response:
    """What of tus is spoken here."""
    headers = {
        "Tus-Version": VERSION,
        "Tus-Extension": EXTENSIONS,
        "Tus-Max-Size": str(services.settings.max_upload_bytes),
    }
    return Response(status_code=204, headers=RESUMABLE | headers)


@router.post(
    "",
    operation_id="createUpload",
    summary="Begin a resumable upload",
    status_code=201,
    response_class=Response,
    responses=problems(408, 409, 412, 413, 415, 422, 507),
    openapi_extra={**_CHUNK, "parameters": _parameters("Upload-Length")},
)
async def create_upload(request: Request, services: Needs) -> Response:
    """The answer's `Location` is where the bytes go by PATCH. The first may come along."""
    require_version(request)
    length = header_number(request, "upload-length")
    _require_room(length, services)
    metadata = request.headers.get("upload-metadata", "")
    name = clean_filename(filename_of(metadata))
    info = await run_in_threadpool(services.uploads.create, length, name, metadata, current().owner)
    if request.headers.get("content-type") == CHUNK_TYPE:
        info = await _append(info, request, services)
    headers = headers_of(info, services.uploads) | {"Location": f"/v1/uploads/{info.id}"}
    return Response(status_code=201, headers=headers)


def _require_room(length: int, services: Services) -> None:
    limit = services.settings.max_upload_bytes
    if length > limit:
        message = f"The upload is larger than the {limit} bytes taken here."
        raise Problem("body_too_large", message, limit_bytes=limit)
    if length == 0:
        raise Problem("invalid_cloud", "The file is empty: it has 0 bytes. Send a point cloud.")
    require_room(services, length)


@router.head(
    "/{upload_id}",
    operation_id="getUploadOffset",
    summary="How far an upload is",
    response_class=Response,
    responses=_OFFSET | problems(404, 410, 412),
    openapi_extra={"parameters": _TUS},
)
async def head_upload(upload_id: str, request: Request, services: Needs) -> Response:
    """`Upload-Offset` is where to go on."""
    require_version(request)
    info = await _completed(await _find(upload_id, services), services)
    headers = headers_of(info, services.uploads) | {"Upload-Length": str(info.length)}
    if info.metadata:
        headers["Upload-Metadata"] = info.metadata
    return Response(status_code=200, headers=headers)


@router.get(
    "/{upload_id}",
    operation_id="getUpload",
    summary="What became of an upload",
    response_model=UploadState,
    responses=problems(404, 410),
)
async def get_upload(upload_id: str, services: Needs) -> UploadState:
    """How far it is, and the scan that it became."""
    info = await _completed(await _find(upload_id, services), services)
    scan = None
    if info.scan_id is not None:
        scan = scan_view(await run_in_threadpool(find_scan, info.scan_id, services))
    return UploadState(
        id=info.id,
        filename=info.filename,
        length=info.length,
        offset=services.uploads.offset(info),
        expires_at=moment(services.uploads.expires_at(info)),
        scan=scan,
        error=JobFailure(code=info.error[0], message=info.error[1]) if info.error else None,
    )


@router.patch(
    "/{upload_id}",
    operation_id="appendUpload",
    summary="Send bytes of an upload",
    status_code=204,
    response_class=Response,
    responses=_EMPTY | problems(404, 408, 409, 410, 412, 413, 415, 422, 423, 507),
    openapi_extra={**_CHUNK, "parameters": _parameters("Upload-Offset")},
)
async def append_upload(upload_id: str, request: Request, services: Needs) -> Response:
    """Appends the body at `Upload-Offset`. With the last byte the upload becomes a scan, which
    the header `Upload-Scan` of the answer names."""
    require_version(request)
    info = await _find(upload_id, services)
    if request.headers.get("content-type") != CHUNK_TYPE:
        raise Problem("unsupported_media_type", f"Send the bytes as {CHUNK_TYPE}.")
    asked = header_number(request, "upload-offset")
    there = services.uploads.offset(info)
    if asked != there:
        raise Problem(
            "upload_conflict",
            f"The upload is at byte {there}, not at {asked}; go on from there.",
            headers=RESUMABLE | {"Upload-Offset": str(there)},
            offset=there,
        )
    if not info.is_settled:
        info = await _append(info, request, services)
    return Response(status_code=204, headers=headers_of(info, services.uploads))


@router.delete(
    "/{upload_id}",
    operation_id="deleteUpload",
    summary="Give an upload up",
    status_code=204,
    response_class=Response,
    responses=problems(404, 410, 412),
    openapi_extra={"parameters": _TUS},
)
async def delete_upload(upload_id: str, request: Request, services: Needs) -> Response:
    """Removes what has come. The scan of a finished upload stays."""
    require_version(request)
    info = await _find(upload_id, services)
    await run_in_threadpool(services.records.mark_gone, info.id)
    await run_in_threadpool(services.uploads.delete, info.id)
    return Response(status_code=204, headers=RESUMABLE)


async def _find(upload_id: str, services: Services) -> UploadInfo:
    info = await run_in_threadpool(services.uploads.read, upload_id)
    if info is not None and current().sees(info.caller):
        return info
    if await run_in_threadpool(services.records.is_gone, upload_id):
        raise Problem("gone", "This upload was deleted or has expired; begin a new one.")
    raise Problem("upload_not_found", "There is no upload with this id; POST /v1/uploads.")


async def _append(info: UploadInfo, request: Request, services: Services) -> UploadInfo:
    """Takes what the request brings. What has come when the client goes away is kept."""
    with ExitStack() as held:
        file = _opened(info, held, services)
        room = info.length - services.uploads.offset(info)
        try:
            await _write_all(limited(request, room), file)
        except ClientDisconnect:
            return info
        if room and file.tell() < info.length:
            return info
        return await _settled(info, services)


async def _write_all(chunks: AsyncIterator[bytes], file: BinaryIO) -> None:
    """Writes a body; whatever ends it early, what came before is written."""
    buffer = bytearray()
    try:
        async for chunk in chunks:
            buffer += chunk
            if len(buffer) >= BUFFER_BYTES:
                await run_in_threadpool(file.write, bytes(buffer))
                buffer.clear()
    finally:
        file.write(buffer)  # at once: a canceled request could not wait for a thread
        file.flush()


def _opened(info: UploadInfo, held: ExitStack, services: Services) -> BinaryIO:
    try:
        return held.enter_context(services.uploads.writing(info.id))
    except UploadBusy as error:
        message = "Another request is writing to this upload; ask for its offset and try again."
        raise Problem("upload_locked", message, headers={"Retry-After": "1"}) from error
    except FileNotFoundError as error:
        raise Problem("gone", "This upload was just deleted; begin a new one.") from error


async def _completed(info: UploadInfo, services: Services) -> UploadInfo:
    """Finishes what a restart interrupted between the last byte and the scan."""
    if info.is_settled or services.uploads.offset(info) < info.length:
        return info
    try:
        with ExitStack() as held:
            _opened(info, held, services)
            return await _settled(info, services)
    except Problem:
        return services.uploads.read(info.id) or info


async def _settled(info: UploadInfo, services: Services) -> UploadInfo:
    """The bytes as a scan.

    Raises:
        Problem: no scan can be made of them; remembered with the upload.
    """
    path = services.uploads.data(info.id)
    upload = await run_in_threadpool(Upload.of_file, path)
    try:
        manifest, _ = await store_scan(upload, Form(filename=info.filename), services)
    except Problem as problem:
        if problem.code in _SETTLING:
            failed = replace(info, error=(problem.code, problem.detail))
            await run_in_threadpool(services.uploads.write, failed)
            path.unlink(missing_ok=True)
        raise
    done = replace(info, scan_id=manifest["id"])
    await run_in_threadpool(services.uploads.write, done)
    path.unlink(missing_ok=True)  # still there if the same bytes were a scan already
    return done
