"""Exit code 0 while the worker of this container shows signs of life in Redis, else 1 and why.

A worker that is idle or fits writes its heartbeat every few seconds; one that hangs does not,
although its process lives.
"""

from __future__ import annotations

import socket
import sys
from datetime import UTC, datetime

import redis

from jobs.dispatch import QUEUE
from jobs.settings import Settings
from udflow.errors import UdflowError

SILENCE_S = 60.0


def trouble(client: redis.Redis, host: str) -> str | None:
    """Why the worker on `host` does not count as alive, or None."""
    ages = []
    for key in client.smembers(f"rq:workers:{QUEUE}"):
        name, beat = client.hmget(key, ["hostname", "last_heartbeat"])
        if name == host and beat:
            written = datetime.fromisoformat(str(beat))
            ages.append((datetime.now(UTC) - written).total_seconds())
    if not ages:
        return f"no worker of {host} is registered"
    if min(ages) > SILENCE_S:
        return f"the worker of {host} was last heard of {min(ages):.0f} s ago"
    return None


def main() -> str | None:
    """As `trouble`, for this container."""
    try:
        with Settings.from_env().connect(socket_timeout=4) as client:
            return trouble(client, socket.gethostname())
    except (redis.RedisError, UdflowError) as error:
        return f"Redis: {error}"


if __name__ == "__main__":
    sys.exit(main())
