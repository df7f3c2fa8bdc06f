"""Named keys beside UDFLOW_KEY: `python -m service.keys add|list|remove`.

A key is shown once, when it is made; Redis holds its SHA-256. Keys are 256 random bits, so a plain
hash of them cannot be searched.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import secrets
import sys
import time
from collections import OrderedDict
from typing import Any

import limits
import redis
import redis.asyncio

from jobs.settings import Settings
from service.callers import READ, SCOPES, WRITE, Caller
from udflow.errors import UdflowError

KEYS = "udflow:keys"  # hash, SHA-256 of the key to its rights: until removed
TICKET_LIFE_S = 30
_REMEMBERED_S = 5.0  # so long a removed key may still work
_MOST_REMEMBERED = 1000


def digest(token: str) -> str:
    """Under what a key or a ticket is stored."""
    return hashlib.sha256(token.encode()).hexdigest()


def ticket_key(ticket: str) -> str:
    """String, the rights of a one-time ticket: TICKET_LIFE_S."""
    return f"udflow:ticket:{digest(ticket)}"


def to_text(caller: Caller) -> str:
    """A caller as Redis keeps it."""
    values = vars(caller) | {"scopes": sorted(caller.scopes)}
    return json.dumps(values)


def from_text(text: str) -> Caller:
    """The inverse of `to_text`."""
    values = json.loads(text)
    return Caller(**{**values, "scopes": frozenset(values["scopes"])})


class KeyBook:
    """Looks keys up, and remembers for a moment what it found. connection: with text answers."""

    def __init__(self, connection: redis.asyncio.Redis) -> None:
        self._redis: Any = connection
        self._known: OrderedDict[str, tuple[float, Caller | None]] = OrderedDict()

    async def find(self, token: str) -> Caller | None:
        """Whose key it is. Raises redis.exceptions.RedisError when Redis does not answer."""
        name, now = digest(token), time.monotonic()
        found = self._known.get(name)
        if found is not None and now - found[0] < _REMEMBERED_S:
            return found[1]
        text = await self._redis.hget(KEYS, name)
        caller = None if text is None else from_text(text)
        self._known[name] = (now, caller)
        while len(self._known) > _MOST_REMEMBERED:
            self._known.popitem(last=False)
        return caller

    async def ticket_for(self, caller: Caller) -> str:
        """A ticket that stands for the caller once, within TICKET_LIFE_S."""
        ticket = secrets.token_urlsafe(32)
        await self._redis.set(ticket_key(ticket), to_text(caller), ex=TICKET_LIFE_S)
        return ticket

    async def redeem(self, ticket: str) -> Caller | None:
        """Whom the ticket stands for; it is used up."""
        text = await self._redis.getdel(ticket_key(ticket))
        return None if text is None else from_text(text)


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = _parser().parse_args(arguments)
    try:
        connection: Any = Settings.from_env().connect()
        options.run(options, connection)
    except (UdflowError, ValueError, redis.RedisError) as error:
        sys.stderr.write(f"udflow: error: {error}\n")
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m service.keys", description="Named keys.")
    commands = parser.add_subparsers(required=True, metavar="command")
    add = commands.add_parser("add", help="make a key and show it once")
    add.add_argument("name", help="letters, digits, - and _")
    add.add_argument("--scopes", default=f"{READ},{WRITE}", help=f"of {', '.join(SCOPES)}")
    add.add_argument("--rate", help="requests, such as 600/minute")
    add.add_argument("--jobs", type=int, help="jobs that may wait and run at once")
    add.add_argument("--jobs-per-day", type=int, help="jobs that may be made a day")
    add.set_defaults(run=_add)
    commands.add_parser("list", help="all names and rights").set_defaults(run=_list)
    remove = commands.add_parser("remove", help="make a key worthless")
    remove.add_argument("name")
    remove.set_defaults(run=_remove)
    return parser


def _add(options: argparse.Namespace, connection: Any) -> None:
    scopes = frozenset(options.scopes.split(","))
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", options.name):
        raise ValueError("a name has 1 to 64 letters, digits, - and _")
    if unknown := scopes - set(SCOPES):
        raise ValueError(f"unknown scope {', '.join(sorted(unknown))}; known: {', '.join(SCOPES)}")
    if options.rate is not None:
        limits.parse(options.rate)
    if options.name in _names(connection):
        raise ValueError(f"there is a key called {options.name} already; remove it first")
    token = f"udf_{secrets.token_urlsafe(32)}"
    caller = Caller(options.name, scopes, options.rate, options.jobs, options.jobs_per_day)
    connection.hset(KEYS, digest(token), to_text(caller))
    sys.stdout.write(f"{token}\n")


def _list(options: argparse.Namespace, connection: Any) -> None:
    for text in sorted(connection.hvals(KEYS)):
        sys.stdout.write(f"{text}\n")


def _remove(options: argparse.Namespace, connection: Any) -> None:
    found = _names(connection).get(options.name)
    if found is None:
        raise ValueError(f"there is no key called {options.name}")
    connection.hdel(KEYS, found)


def _names(connection: Any) -> dict[str, str]:
    stored: dict[str, str] = connection.hgetall(KEYS)
    return {json.loads(text)["name"]: name for name, text in stored.items()}


if __name__ == "__main__":
    sys.exit(main())
