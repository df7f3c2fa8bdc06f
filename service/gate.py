"""What every request and every websocket passes first.

Plain ASGI on purpose: HTTP middleware of the frameworks does not run for websockets, and a
handshake needs the same checks of host, origin and key.
"""

from __future__ import annotations

import asyncio
import hmac
import re
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.page import is_open
from service.problems import Problem
from service.settings import LOOPBACK_HOSTS, ServiceSettings

OPEN_PATHS = ("/healthz", "/readyz")
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class Gate:
    """Request ids, host, origin and key checks, security headers, a deadline for slow bodies."""

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self.app = app
        self.settings = settings
        self.hosts = {*LOOPBACK_HOSTS, *settings.allowed_hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = _request_id(headers)
        scope.setdefault("state", {})["request_id"] = request_id
        send = _with_headers(send, request_id)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await refusal.response(scope)(scope, receive, send)
        elif scope["type"] == "http":
            timed = _with_deadline(receive, self.settings.body_timeout_s)
            await self.app(scope, timed, send)
        else:
            await self.app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> Problem | None:
        host = headers.get("host", "").lower()
        if self.settings.key is None and _hostname(host) not in self.hosts:
            return Problem(
                "host_not_allowed",
                "Use the address the service printed at its start, or name this host in "
                "UDFLOW_ALLOWED_HOSTS.",
            )
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host:
            return Problem(
                "cross_origin", "This request comes from a page of another site; none is allowed."
            )
        path = scope["path"].removeprefix(scope.get("root_path", ""))
        if path in OPEN_PATHS or is_open(path) or self._has_key(headers):
            return None
        return Problem(
            "unauthorized",
            "Send the header Authorization: Bearer <key>, with the key of this service.",
            headers={"WWW-Authenticate": "Bearer"},
        )

    def _has_key(self, headers: Headers) -> bool:
        if self.settings.key is None:
            return True
        scheme, _, token = headers.get("authorization", "").partition(" ")
        same = hmac.compare_digest(token.strip().encode(), self.settings.key.encode())
        return scheme.lower() == "bearer" and same


def _hostname(host: str) -> str:
    """The Host header without its port; IPv6 keeps its brackets."""
    return re.sub(r":\d*$", "", host)


def _request_id(headers: Headers) -> str:
    sent = headers.get("x-request-id", "")
    return sent if _REQUEST_ID.fullmatch(sent) else secrets.token_hex(8)


def _with_headers(send: Send, request_id: str) -> Send:
    async def wrapped(message: Message) -> None:
        if message["type"] in ("http.response.start", "websocket.http.response.start"):
            headers = MutableHeaders(scope=message)
            headers["X-Request-Id"] = request_id
            for name, value in SECURITY_HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return wrapped


def _with_deadline(receive: Receive, seconds: float) -> Receive:
    """Bodies must keep arriving; after the body, waiting for the disconnect may take forever."""
    complete = False

    async def wrapped() -> Message:
        nonlocal complete
        if complete:
            return await receive()
        try:
            message = await asyncio.wait_for(receive(), seconds)
        except TimeoutError as error:
            complete = True
            detail = f"No byte of the body arrived for {seconds:g} s; send it again."
            headers = {"Connection": "close"}
            raise Problem("request_timeout", detail, headers=headers) from error
        complete = not message.get("more_body", False)
        return message

    return wrapped
