"""What every request and every websocket passes first.

Plain ASGI on purpose: HTTP middleware of the frameworks does not run for websockets, and a
handshake needs the same checks of host, origin and key.
"""

from __future__ import annotations

import asyncio
import re
import secrets

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.admission import Admission
from service.callers import calling
from service.problems import Problem
from service.settings import ServiceSettings

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class Gate:
    """Request ids, admission, security headers, a deadline for slow bodies."""

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self.app = app
        self.settings = settings
        self.admission = Admission(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = _request_id(headers)
        state = scope.setdefault("state", {})
        state["request_id"] = request_id
        try:
            caller, told = await self.admission.admitted(scope, headers)
        except Problem as refusal:
            answer = refusal.response(scope)
            await answer(scope, receive, _with_headers(send, {"X-Request-Id": request_id}))
            return
        state["caller"] = caller.name
        if scope["type"] == "http":
            receive = _with_deadline(receive, self.settings.body_timeout_s)
        with calling(caller):
            await self.app(
                scope, receive, _with_headers(send, {"X-Request-Id": request_id, **told})
            )


def _request_id(headers: Headers) -> str:
    sent = headers.get("x-request-id", "")
    return sent if _REQUEST_ID.fullmatch(sent) else secrets.token_hex(8)


def _with_headers(send: Send, more: dict[str, str]) -> Send:
    async def wrapped(message: Message) -> None:
        if message["type"] in ("http.response.start", "websocket.http.response.start"):
            headers = MutableHeaders(scope=message)
            headers.update(more)
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
            async with asyncio.timeout(seconds):
                message = await receive()
        except TimeoutError as error:
            complete = True
            detail = f"No byte of the body arrived for {seconds:g} s; send it again."
            headers = {"Connection": "close"}
            raise Problem("request_timeout", detail, headers=headers) from error
        complete = not message.get("more_body", False)
        return message

    return wrapped
