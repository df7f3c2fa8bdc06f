"""Every error that leaves the service: RFC 9457 problem details with a stable code."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from redis.exceptions import BusyLoadingError, OutOfMemoryError, ReadOnlyError, ResponseError
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import TimeoutError as RedisTimeoutError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import BaseRoute, Match

log = logging.getLogger("service")

# code: (status, title). Codes never change their meaning; docs/api.md explains each of them.
PROBLEMS: dict[str, tuple[int, str]] = {
    "malformed_request": (400, "The request cannot be read"),
    "unauthorized": (401, "A valid key is required"),
    "cross_origin": (403, "Requests from other sites are refused"),
    "forbidden": (403, "The key lacks a right"),
    "not_found": (404, "There is nothing at this address"),
    "scan_not_found": (404, "No scan has this id"),
    "sample_not_found": (404, "No sample has this name"),
    "job_not_found": (404, "No job has this id"),
    "upload_not_found": (404, "No upload has this id"),
    "artifact_not_found": (404, "The job has no such result"),
    "method_not_allowed": (405, "This address does not take this method"),
    "request_timeout": (408, "The request body stopped arriving"),
    "job_not_finished": (409, "The job has not finished"),
    "job_finished": (409, "The job has already ended"),
    "job_failed": (409, "The job ended without a result"),
    "outdated_field": (409, "Another release stored the field"),
    "scan_in_use": (409, "Jobs are using the scan"),
    "upload_conflict": (409, "The upload has another offset"),
    "gone": (410, "It was deleted or has expired"),
    "tus_version": (412, "Another version of the tus protocol is spoken here"),
    "body_too_large": (413, "The request body is too large"),
    "unknown_format": (415, "The bytes are of no known point cloud format"),
    "unsupported_media_type": (415, "The body is of an unsupported type"),
    "range_not_satisfiable": (416, "The range lies outside the file"),
    "host_not_allowed": (421, "The service does not answer under this host name"),
    "invalid_request": (422, "The request has invalid values"),
    "invalid_cloud": (422, "The point cloud cannot be reconstructed"),
    "scan_too_costly": (422, "Reading the scan needs too much memory or time"),
    "invalid_query": (422, "The query points are invalid"),
    "idempotency_conflict": (422, "The idempotency key was used for another request"),
    "job_too_costly": (422, "The job needs more than this machine has"),
    "upload_locked": (423, "Another request is writing to this upload"),
    "queue_full": (429, "Too many jobs are waiting"),
    "too_many_jobs": (429, "The key has as many jobs as it may have"),
    "quota_exceeded": (429, "The key has used up its quota"),
    "rate_limited": (429, "Too many requests"),
    "internal_error": (500, "The service made a mistake"),
    "artifact_damaged": (500, "A stored file is damaged"),
    "not_ready": (503, "The service is not ready"),
    "queue_unavailable": (503, "The job queue does not answer"),
    "store_unavailable": (503, "The store of scans and results does not answer"),
    "storage_full": (507, "The disk of the service is full"),
}

_REFUSALS = ("OOM", "MISCONF", "READONLY", "NOREPLICAS")  # as Redis says from inside a script
_BY_STATUS = {404: "not_found", 405: "method_not_allowed", 413: "body_too_large"}


class Problem(Exception):
    """An answer that is not a success.

    Attributes:
        code: one of PROBLEMS; decides status and title.
        detail: cause and remedy in words.
        errors: what is wrong where: (pointer, code, message). The pointer is "#/a/b" for a value
            of the body, "?name" for a query parameter, "header:name" for a header.
        headers: extra response headers.
        members: extra members of the problem object.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        errors: Sequence[tuple[str, str, str]] = (),
        headers: Mapping[str, str] | None = None,
        **members: Any,
    ) -> None:
        super().__init__(detail)
        self.code = code
        self.status, self.title = PROBLEMS[code]
        self.detail = detail
        self.errors = tuple(errors)
        self.headers = dict(headers or {})
        self.members = members

    def response(self, scope: Mapping[str, Any]) -> JSONResponse:
        """The answer to the request of this ASGI scope."""
        body: dict[str, Any] = {
            "type": f"urn:udflow:problem:{self.code}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "instance": scope.get("path", ""),
            "code": self.code,
            "request_id": scope.get("state", {}).get("request_id", ""),
            **self.members,
        }
        if self.errors:
            names = ("pointer", "code", "message")
            body["errors"] = [dict(zip(names, error, strict=True)) for error in self.errors]
        return JSONResponse(body, self.status, self.headers, "application/problem+json")


def invalid(pointer: str, code: str, message: str) -> Problem:
    """A 422 about one value of the request."""
    return Problem("invalid_request", message, errors=[(pointer, code, message)])


def queue_unavailable() -> Problem:
    """A 503: Redis is away."""
    return Problem(
        "queue_unavailable",
        "Redis does not answer. Try again in a few seconds; nothing was changed.",
        headers={"Retry-After": "2"},
    )


def install(app: FastAPI) -> None:
    """Give every error of the application the problem form."""
    app.add_exception_handler(Problem, _on_problem)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    app.add_exception_handler(OSError, _on_os_error)
    with suppress(ModuleNotFoundError):  # only where scans lie in a bucket
        from obstore.exceptions import BaseError

        app.add_exception_handler(BaseError, _on_store_error)
    for error in (RedisConnectionError, RedisTimeoutError, BusyLoadingError):
        app.add_exception_handler(error, _on_redis_error)
    app.add_exception_handler(ResponseError, _on_redis_refusal)
    app.add_exception_handler(Exception, _on_bug)


def from_validation(errors: Sequence[Any]) -> Problem:
    """A 422 from pydantic's list of errors; the values themselves are not repeated."""
    found = [(_pointer(error["loc"]), _code(error), _message(error)) for error in errors]
    detail = "; ".join(f"{pointer}: {message}" for pointer, _, message in found[:3])
    return Problem("invalid_request", detail, errors=found)


def _pointer(location: Sequence[Any]) -> str:
    if location and location[0] in ("query", "header"):
        return f"?{location[1]}" if location[0] == "query" else f"header:{location[1]}"
    parts = [str(part).replace("~", "~0").replace("/", "~1") for part in location]
    return "/".join(["#", *parts])


def _code(error: Mapping[str, Any]) -> str:
    return {"extra_forbidden": "unknown_key", "missing": "missing"}.get(
        error["type"], "invalid_value"
    )


def _message(error: Mapping[str, Any]) -> str:
    if error["type"] == "extra_forbidden":
        return f'unknown key "{error["loc"][-1]}"'
    return str(error["msg"]).removeprefix("Value error, ")


async def _on_problem(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, Problem)
    return error.response(request.scope)


async def _on_http_exception(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    code = _BY_STATUS.get(error.status_code, "malformed_request")
    details = {
        "not_found": "Nothing is served at this address; /openapi.json lists what is.",
        "method_not_allowed": f"{request.method} is not possible here.",
    }
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = ", ".join(_methods_at(request))
    problem = Problem(code, details.get(code, str(error.detail)), headers=headers)
    return problem.response(request.scope)


def _methods_at(request: Request) -> list[str]:
    """What the address takes; the framework names only the methods of the first route there."""
    found: set[str] = set()
    for route in _routes(request.app.routes):
        if route.matches(request.scope)[0] is not Match.NONE:
            found |= getattr(route, "methods", None) or set()
    return sorted(found)


def _routes(routes: Sequence[BaseRoute]) -> Iterator[BaseRoute]:
    for route in routes:
        included = getattr(route, "original_router", None)
        yield from [route] if included is None else _routes(included.routes)


async def _on_validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    return from_validation(error.errors()).response(request.scope)


async def _on_disconnect(request: Request, _: Exception) -> JSONResponse:
    # Nobody is left to read this; it keeps an ordinary event out of the error log.
    problem = Problem("malformed_request", "The client closed the connection early.")
    return problem.response(request.scope)


async def _on_redis_error(request: Request, error: Exception) -> JSONResponse:
    log.error("redis does not answer: %s", error)
    return queue_unavailable().response(request.scope)


async def _on_redis_refusal(request: Request, error: Exception) -> JSONResponse:
    """A Redis that is full, cannot write its file or may not be written to changes nothing."""
    full = isinstance(error, OutOfMemoryError | ReadOnlyError)
    if full or any(word in str(error) for word in _REFUSALS):
        log.error("redis takes nothing: %s", error)
        return queue_unavailable().response(request.scope)
    return await _on_bug(request, error)


async def _on_store_error(request: Request, error: Exception) -> JSONResponse:
    log.error("the store does not answer: %s", error)
    problem = Problem(
        "store_unavailable",
        "The store of scans and results does not answer. Try again in a few seconds.",
        headers={"Retry-After": "5"},
    )
    return problem.response(request.scope)


async def _on_os_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, OSError)
    if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        raise error
    problem = Problem("storage_full", "The disk is full; nothing of this request was kept.")
    return problem.response(request.scope)


async def _on_bug(request: Request, error: Exception) -> JSONResponse:
    # The client gets the id to find the traceback by.
    about = request.scope.get("state", {}).get("request_id")
    fields = {"fields": {"request_id": about}}
    log.error("unexpected error in request %s", about, exc_info=error, extra=fields)
    problem = Problem(
        "internal_error", "An unexpected error was logged under this request_id; please report it."
    )
    return problem.response(request.scope)
