"""Everything about the front door that the environment decides."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Mapping
from dataclasses import dataclass

LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "[::1]")


class SettingsError(ValueError):
    """An environment variable has a value the service cannot run with."""


@dataclass(frozen=True)
class ServiceSettings:
    """Where the service listens and what it accepts.

    Attributes:
        host, port: UDFLOW_HOST and PORT. Any address but loopback needs a key.
        key: UDFLOW_KEY, the bearer token every request must carry; None on loopback only.
        allowed_hosts: UDFLOW_ALLOWED_HOSTS, further names the service answers under. Only asked
            without a key: a page that rebinds its own name to this address knows no key.
        max_upload_bytes: UDFLOW_MAX_UPLOAD_MB, largest scan.
        inspect_memory_bytes, inspect_seconds: UDFLOW_INSPECT_MEMORY_MB, UDFLOW_INSPECT_SECONDS,
            limits of the child process that reads an upload.
        body_timeout_s: UDFLOW_BODY_TIMEOUT_S, longest silence inside a request body.
        queue_limit: UDFLOW_QUEUE_LIMIT, jobs that may wait before new ones are refused.
        min_free_bytes: UDFLOW_MIN_FREE_MB, disk space below which the service is not ready.
        ttl_s, max_ttl_s: UDFLOW_TTL_S, UDFLOW_MAX_TTL_S, how long a job and its files are kept
            after its end if the caller does not say, and at most.
    """

    host: str = "127.0.0.1"
    port: int = 8000
    key: str | None = None
    allowed_hosts: tuple[str, ...] = ()
    max_upload_bytes: int = 2048 << 20
    inspect_memory_bytes: int = 4096 << 20
    inspect_seconds: int = 120
    body_timeout_s: float = 30.0
    queue_limit: int = 1000
    min_free_bytes: int = 512 << 20
    ttl_s: float = 7 * 24 * 3600.0
    max_ttl_s: float = 90 * 24 * 3600.0

    def __post_init__(self) -> None:
        if not 0 < self.port < 65536:
            raise SettingsError(f"PORT is {self.port}; choose 1 to 65535.")
        if self.key is not None and len(self.key) < 16:
            raise SettingsError("UDFLOW_KEY is too short; use 16 characters or more.")
        if not 0 < self.ttl_s <= self.max_ttl_s:
            raise SettingsError("UDFLOW_TTL_S must be above 0 and at most UDFLOW_MAX_TTL_S.")
        if self.key is None and not _is_loopback(self.host):
            raise SettingsError(
                f"Refusing to listen on {self.host} without a key: anyone who reaches the port "
                "could read and submit scans. Set UDFLOW_KEY to a long random secret, or leave "
                "UDFLOW_HOST at 127.0.0.1."
            )


def from_environment(environ: Mapping[str, str] = os.environ) -> ServiceSettings:
    """The settings of this process.

    Raises:
        SettingsError: a value is malformed, or the address is open to others without a key.
    """
    hosts = environ.get("UDFLOW_ALLOWED_HOSTS", "").split(",")
    return ServiceSettings(
        host=environ.get("UDFLOW_HOST") or "127.0.0.1",
        port=_whole(environ, "PORT", 8000),
        key=environ.get("UDFLOW_KEY") or None,
        allowed_hosts=tuple(host.strip().lower() for host in hosts if host.strip()),
        max_upload_bytes=_whole(environ, "UDFLOW_MAX_UPLOAD_MB", 2048) << 20,
        inspect_memory_bytes=_whole(environ, "UDFLOW_INSPECT_MEMORY_MB", 4096) << 20,
        inspect_seconds=_whole(environ, "UDFLOW_INSPECT_SECONDS", 120),
        body_timeout_s=_whole(environ, "UDFLOW_BODY_TIMEOUT_S", 30),
        queue_limit=_whole(environ, "UDFLOW_QUEUE_LIMIT", 1000),
        min_free_bytes=_whole(environ, "UDFLOW_MIN_FREE_MB", 512) << 20,
        ttl_s=_whole(environ, "UDFLOW_TTL_S", 7 * 24 * 3600),
        max_ttl_s=_whole(environ, "UDFLOW_MAX_TTL_S", 90 * 24 * 3600),
    )


def _whole(environ: Mapping[str, str], name: str, default: int) -> int:
    text = environ.get(name) or str(default)
    if not text.isascii() or not text.isdigit():
        raise SettingsError(f'{name} is "{text}"; give a whole number.')
    return int(text)


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
