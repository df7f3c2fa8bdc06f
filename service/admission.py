"""Who may pass: host, origin, key, right and rate of a request or a websocket's handshake."""

from __future__ import annotations

import hmac
import re
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from redis.exceptions import RedisError
from starlette.datastructures import Headers
from starlette.types import Scope

from service.callers import Caller, scope_needed
from service.page import is_open
from service.problems import Problem, queue_unavailable
from service.settings import LOOPBACK_HOSTS, ServiceSettings

if TYPE_CHECKING:
    from service.services import Services

OPEN_PATHS = ("/healthz", "/readyz")
_ANYBODY = Caller(scopes=frozenset())
_MAIN = Caller(name="main")


class Admission:
    """The rules of the front door."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._key = settings.key
        self._hosts = {*LOOPBACK_HOSTS, *settings.allowed_hosts}

    async def admitted(self, scope: Scope, headers: Headers) -> tuple[Caller, dict[str, str]]:
        """The caller, and headers that the answer is to carry.

        Raises:
            Problem: the request may not pass.
        """
        self._refuse_foreign(headers)
        path = scope["path"].removeprefix(scope.get("root_path", ""))
        if path in OPEN_PATHS or is_open(path):
            return _ANYBODY, {}
        if self._key is None:
            return Caller(), {}
        services: Services = scope["app"].state.services
        try:
            caller = await self._known(scope, headers, services)
        except RedisError as error:
            raise queue_unavailable() from error
        if caller is None:
            raise await _unauthorized(scope, headers, services)
        needed = scope_needed(scope.get("method", "GET"), path)
        if not caller.may(needed):
            raise Problem("forbidden", f'This key lacks the right "{needed}".', needed=needed)
        allowance = await services.rates.count(caller)
        told = allowance.headers() if allowance is not None else {}
        if allowance is not None and allowance.refused:
            message = f"This key may ask {caller.rate}; ask again in {allowance.reset_s} s."
            raise Problem("rate_limited", message, headers=told)
        return caller, told

    def _refuse_foreign(self, headers: Headers) -> None:
        host = headers.get("host", "").lower()
        if self._key is None and re.sub(r":\d*$", "", host) not in self._hosts:
            raise Problem(
                "host_not_allowed",
                "Use the address the service printed at its start, or name this host in "
                "UDFLOW_ALLOWED_HOSTS.",
            )
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host:
            raise Problem(
                "cross_origin", "This request comes from a page of another site; none is allowed."
            )

    async def _known(self, scope: Scope, headers: Headers, services: Services) -> Caller | None:
        """Whose key or ticket it is."""
        scheme, _, token = headers.get("authorization", "").partition(" ")
        token = token.strip()
        if scheme.lower() == "bearer" and token:
            if hmac.compare_digest(token.encode(), (self._key or "").encode()):
                return _MAIN
            return await services.keys.find(token)
        if scope["type"] == "websocket":  # browsers can send no header there
            query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
            for ticket in query.get("ticket", [])[:1]:
                return await services.keys.redeem(ticket)
        return None


async def _unauthorized(scope: Scope, headers: Headers, services: Services) -> Problem:
    allowance = None
    if "authorization" in headers:  # a guess, not an oversight
        client = scope.get("client") or ("unknown", 0)
        allowance = await services.rates.count_wrong_key(str(client[0]))
    if allowance is not None and allowance.refused:
        message = "Too many wrong keys came from this address; wait a minute."
        return Problem("rate_limited", message, headers=allowance.headers())
    return Problem(
        "unauthorized",
        "Send the header Authorization: Bearer <key>, with a key of this service.",
        headers={"WWW-Authenticate": "Bearer"},
    )
