"""Every request as a line in the log and in the figures of /metrics. The outermost layer."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass, field

from starlette.types import ASGIApp, Message, Receive, Scope, Send

BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
_QUIET = ("/healthz", "/readyz", "/metrics")
log = logging.getLogger("service.requests")


@dataclass
class Traffic:
    """What this process has answered since it started.

    requests: by (method, route, status); buckets: by (route, upper bound in seconds), not yet
    cumulative; seconds: by route; received: bytes of bodies.
    """

    requests: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    buckets: Counter[tuple[str, float]] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    received: int = 0

    def note(self, method: str, route: str, status: int, seconds: float) -> None:
        """A request was answered."""
        self.requests[method, route, status] += 1
        bound = next((limit for limit in BUCKETS_S if seconds <= limit), float("inf"))
        self.buckets[route, bound] += 1
        self.seconds[route] += seconds  # type: ignore[assignment]


class Watched:
    """Plain ASGI around everything else; `app.state.traffic` holds the figures."""

    def __init__(self, app: ASGIApp, traffic: Traffic) -> None:
        self.app = app
        self.traffic = traffic

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began, status = time.monotonic(), 500

        async def counted() -> Message:
            message = await receive()
            self.traffic.received += len(message.get("body", b""))
            return message

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self.app(scope, counted, noted)
        finally:
            self._tell(scope, status, time.monotonic() - began)

    def _tell(self, scope: Scope, status: int, seconds: float) -> None:
        route = getattr(scope.get("route"), "path", "none")
        self.traffic.note(scope["method"], route, status, seconds)
        state = scope.get("state", {})
        level = logging.DEBUG if scope["path"] in _QUIET else logging.INFO
        about = {
            "method": scope["method"],
            "path": scope["path"],
            "status": status,
            "ms": round(1000 * seconds, 1),
            "request_id": state.get("request_id"),
            "caller": state.get("caller"),
        }
        log.log(level, "%(method)s %(path)s %(status)s %(ms)s ms", about, extra={"fields": about})
