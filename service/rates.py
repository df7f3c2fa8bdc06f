"""How often a caller may ask, counted in Redis for all API processes together."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import dataclass

import limits
import redis.asyncio
from limits.aio.storage import RedisStorage
from limits.aio.strategies import SlidingWindowCounterRateLimiter
from redis.exceptions import RedisError

from service.callers import Caller

WRONG_KEYS = "60/minute"  # from one address
log = logging.getLogger("service")


@dataclass(frozen=True)
class Allowance:
    """What is left of a rate. limit: requests in `window_s`; left: of them; reset_s: until more."""

    limit: int
    window_s: int
    left: int
    reset_s: int
    refused: bool

    def headers(self) -> dict[str, str]:
        """As draft-ietf-httpapi-ratelimit-headers says it."""
        found = {
            "RateLimit": f'"requests";r={self.left};t={self.reset_s}',
            "RateLimit-Policy": f'"requests";q={self.limit};w={self.window_s}',
        }
        return found | ({"Retry-After": str(max(1, self.reset_s))} if self.refused else {})


class Rates:
    """connection: of redis.asyncio. While Redis is away nobody is refused: the rest fails then."""

    def __init__(self, connection: redis.asyncio.Redis) -> None:
        storage = RedisStorage(
            "async+redis://",
            implementation="redispy",
            key_prefix="udflow:rates",
            connection_pool=connection.connection_pool,  # type: ignore[arg-type]
        )
        self._limiter = SlidingWindowCounterRateLimiter(storage)

    async def count(self, caller: Caller) -> Allowance | None:
        """Counts a request. None: it is not counted."""
        if caller.rate is None:
            return None
        return await self._hit(limits.parse(caller.rate), "key", str(caller.name))

    async def count_wrong_key(self, address: str) -> Allowance | None:
        """Counts a request with a wrong key."""
        return await self._hit(limits.parse(WRONG_KEYS), "wrong", address)

    async def count_job(self, caller: Caller) -> Allowance | None:
        """Counts a job against the day's quota."""
        if caller.jobs_per_day is None:
            return None
        quota = limits.RateLimitItemPerDay(caller.jobs_per_day)
        return await self._hit(quota, "jobs", str(caller.name))

    async def _hit(self, rate: limits.RateLimitItem, *names: str) -> Allowance | None:
        try:
            allowed = await self._limiter.hit(rate, *names)
            reset, left = await self._limiter.get_window_stats(rate, *names)
        except RedisError as error:
            log.warning("requests are not counted: %s", error)
            return None
        seconds = max(0, math.ceil(reset - time.time()))
        return Allowance(rate.amount, rate.get_expiry(), left, seconds, refused=not allowed)
