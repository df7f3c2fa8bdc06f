"""Who is asking: the key that came with a request, and what it allows.

The gate sets the caller for the time of one request; whatever the request starts sees it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

READ, WRITE, METRICS, ADMIN = "read", "write", "metrics", "admin"
SCOPES = (READ, WRITE, METRICS, ADMIN)
_ASKING = ("/udf", "/udf/slice")  # a POST that changes nothing


@dataclass(frozen=True)
class Caller:
    """A key's name and rights.

    name: None where no key is needed. scopes: read (look, download, ask distances), write
    (upload, start, stop, delete), metrics, admin (everything, and of everybody). rate: requests,
    such as "600/minute"; jobs: that may wait and run at once; jobs_per_day: that may be made.
    """

    name: str | None = None
    scopes: frozenset[str] = frozenset(SCOPES)
    rate: str | None = None
    jobs: int | None = None
    jobs_per_day: int | None = None

    @property
    def owner(self) -> str | None:
        """Whose the things are that it makes; None: of nobody in particular."""
        return None if ADMIN in self.scopes else self.name

    def may(self, scope: str) -> bool:
        """Whether the key has the right."""
        return ADMIN in self.scopes or scope in self.scopes

    def sees(self, owner: str | None) -> bool:
        """Whether things of this owner are there for it."""
        return ADMIN in self.scopes or owner == self.name


_current: ContextVar[Caller] = ContextVar("caller", default=Caller())  # noqa: B039


def current() -> Caller:
    """Who the request that is being answered comes from."""
    return _current.get()


@contextmanager
def calling(caller: Caller) -> Iterator[None]:
    """The caller for the time of the block."""
    token = _current.set(caller)
    try:
        yield
    finally:
        _current.reset(token)


def scope_needed(method: str, path: str) -> str:
    """The right that a request takes."""
    if path == "/metrics":
        return METRICS
    if method in ("GET", "HEAD", "OPTIONS") or path.endswith(_ASKING):
        return READ
    return WRITE
