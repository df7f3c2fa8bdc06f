"""Whether an accepted job would survive and be run."""

from __future__ import annotations

from collections.abc import Callable

from redis.exceptions import RedisError

from service.schemas import Check
from service.services import Services


def readiness(services: Services) -> list[Check]:
    """Every check with its outcome in words."""
    checks: dict[str, Callable[[Services], tuple[bool, str]]] = {
        "redis": _redis,
        "worker": _worker,
        "disk": _disk,
    }
    return [_checked(name, check, services) for name, check in checks.items()]


def _checked(name: str, check: Callable[[Services], tuple[bool, str]], services: Services) -> Check:
    try:
        ok, detail = check(services)
    except RedisError:
        ok, detail = False, "Redis does not answer"
    except OSError as error:
        ok, detail = False, f"the data folder cannot be used: {error.strerror}"
    return Check(name=name, ok=ok, detail=detail)


def _redis(services: Services) -> tuple[bool, str]:
    persistence = services.redis.info("persistence")
    if not persistence.get("aof_enabled"):
        return False, "it would forget jobs when it stops; start it with --appendonly yes"
    if persistence.get("aof_last_write_status", "ok") != "ok":
        return False, "it cannot write its append-only file; is its disk full?"
    return True, "answers and keeps an append-only file"


def _worker(services: Services) -> tuple[bool, str]:
    count = services.dispatcher.workers()
    return count > 0, f"{count} alive" if count else "none is alive; start one: python -m worker"


def _disk(services: Services) -> tuple[bool, str]:
    free, wanted = services.store.free_bytes(), services.settings.min_free_bytes
    return free >= wanted, f"{free >> 20} MB free, {wanted >> 20} MB wanted"
