"""Stored files as downloads: ranges, validators, names."""

from __future__ import annotations

import re
from pathlib import Path

from fastapi import Request
from fastapi.responses import FileResponse, Response

from service.problems import Problem


def file_response(
    request: Request, path: Path, *, sha256: str, media_type: str, filename: str
) -> Response:
    """The file as an attachment whose ETag is its sha256.

    Answers If-None-Match by 304, Range by 206, a Range outside the file by 416. Malformed ranges
    are ignored, as RFC 9110 allows.

    Raises:
        Problem: 416.
    """
    etag = f'"{sha256}"'
    # immutable content may be kept, but only by the caller who was allowed to fetch it
    headers = {"ETag": etag, "Cache-Control": "private, max-age=3600"}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    _check_range(request, path.stat().st_size)
    return FileResponse(path, headers=headers, media_type=media_type, filename=filename)


def redirected(request: Request, link: str, *, sha256: str, size: int) -> Response:
    """Sends the caller to where the file is; HEAD and If-None-Match are answered here."""
    etag = f'"{sha256}"'
    headers = {"ETag": etag, "Cache-Control": "private, no-cache"}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    if request.method == "HEAD":
        return Response(headers=headers | {"Content-Length": str(size)})
    return Response(status_code=307, headers=headers | {"Location": link})


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether an If-None-Match header names this ETag (weak comparison)."""
    if if_none_match is None:
        return False
    known = [tag.strip().removeprefix("W/") for tag in if_none_match.split(",")]
    return "*" in known or etag.removeprefix("W/") in known


def _check_range(request: Request, size: int) -> None:
    if "range" not in request.headers:
        return
    found = _single_range(request.headers["range"])
    if found is None:
        headers = request.scope["headers"]
        request.scope["headers"] = [(name, value) for name, value in headers if name != b"range"]
    elif (found[0] or 0) >= size or found == (None, 0):
        raise Problem(
            "range_not_satisfiable",
            f"The file has {size} bytes.",
            headers={"Content-Range": f"bytes */{size}"},
        )


def _single_range(header: str) -> tuple[int | None, int | None] | None:
    """(first, last) of a well-formed range, None for any other: those are not honoured."""
    found = re.fullmatch(r"bytes=(\d{0,18})-(\d{0,18})", header.replace(" ", ""))
    if found is None or found.group(0) == "bytes=-":
        return None
    first, last = (int(text) if text else None for text in found.groups())
    if first is not None and last is not None and last < first:
        return None
    return first, last
