"""Telling callers' servers about their jobs: what waits to be sent, and what became of it.

The scripts that change a job's state put `<job id>:<state>` into the queue in the same step, so
none is lost; `python -m worker.webhooks` sends. Signatures are those of Standard Webhooks.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import ipaddress
import json
import random
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import redis

from jobs import keys
from jobs.errors import BadSetting
from jobs.spec import JobRecord

BACKOFF_S = (5.0, 30.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 36000.0)
LOGGED = 50  # deliveries remembered for each job
_TAKEN_S = 60.0  # a sender that has not settled a delivery by then has died

# ARGV: now, until when it is taken, how many
_TAKE = """
local due = redis.call('ZRANGEBYSCORE', KEYS[1], '-inf', ARGV[1], 'LIMIT', 0, ARGV[3])
for _, member in ipairs(due) do redis.call('ZADD', KEYS[1], ARGV[2], member) end
return due
"""


@dataclass(frozen=True)
class Delivery:
    """One try. status: of the answer, None if there was none; error: in words; time: Unix seconds;
    next_at: when it is tried again, None if it is not."""

    event: str
    time: float
    attempt: int
    status: int | None
    error: str | None
    next_at: float | None


class WebhookQueue:
    """What is to be sent, in one Redis. connection: with text answers."""

    def __init__(self, connection: redis.Redis) -> None:
        self._redis: Any = connection
        self._take = connection.register_script(_TAKE)

    def take(self, now: float, most: int) -> list[tuple[str, str]]:
        """(job id, state) of deliveries that are due; others do not get them for a minute."""
        due = self._take(keys=[keys.WEBHOOKS], args=[now, now + _TAKEN_S, most])
        return [(job_id, state) for job_id, _, state in (text.partition(":") for text in due)]

    def tried(self, job_id: str, state: str) -> int:
        """How often it was tried before."""
        return int(self._redis.hget(keys.webhook_tries(job_id), state) or 0)

    def settle(self, job_id: str, state: str, delivery: Delivery) -> None:
        """Note a try, and forget the delivery or have it tried again at `delivery.next_at`."""
        log, tries = keys.deliveries(job_id), keys.webhook_tries(job_id)
        member = f"{job_id}:{state}"
        with self._redis.pipeline() as pipe:
            pipe.lpush(log, json.dumps(asdict(delivery)))
            pipe.ltrim(log, 0, LOGGED - 1)
            pipe.expire(log, keys.DELIVERIES_LIFE_S)
            pipe.hset(tries, state, delivery.attempt)
            pipe.expire(tries, keys.DELIVERIES_LIFE_S)
            if delivery.next_at is None:
                pipe.zrem(keys.WEBHOOKS, member)
            else:
                pipe.zadd(keys.WEBHOOKS, {member: delivery.next_at})
            pipe.execute()

    def send_again(self, job_id: str, state: str) -> None:
        """Have a delivery made now, as if it had never been tried."""
        with self._redis.pipeline() as pipe:
            pipe.hdel(keys.webhook_tries(job_id), state)
            pipe.zadd(keys.WEBHOOKS, {f"{job_id}:{state}": 0})
            pipe.execute()

    def forget(self, job_id: str, state: str) -> None:
        """There is nothing to send: the job was deleted."""
        self._redis.zrem(keys.WEBHOOKS, f"{job_id}:{state}")

    def deliveries(self, job_id: str) -> list[Delivery]:
        """The last tries, newest first."""
        return [
            Delivery(**json.loads(text))
            for text in self._redis.lrange(keys.deliveries(job_id), 0, -1)
        ]


def event_type(state: str) -> str:
    """The name of the event that tells of a state."""
    return "job.started" if state == "running" else f"job.{state}"


def message(record: JobRecord, state: str) -> dict[str, Any]:
    """What is told: enough to know whether to ask for more."""
    since = record.started_at if state == "running" else record.finished_at
    moment = datetime.fromtimestamp(since or record.created_at, UTC)
    return {
        "type": event_type(state),
        "timestamp": moment.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "data": {
            "id": record.id,
            "kind": record.kind,
            "scan_id": record.scan_id,
            "state": state,
            "attempt": record.attempt,
            "metadata": record.metadata,
            "error": asdict(record.error) if record.error and state == "failed" else None,
            "url": f"/v1/jobs/{record.id}",
        },
    }


def secret_of(text: str) -> bytes:
    """The key in `whsec_<base64>`.

    Raises:
        BadSetting: it is malformed or shorter than 24 bytes.
    """
    try:
        key = base64.b64decode(text.removeprefix("whsec_"), validate=True)
    except (binascii.Error, ValueError):
        key = b""
    if len(key) < 24:
        raise BadSetting(
            "UDFLOW_WEBHOOK_SECRET must be whsec_ and at least 24 random bytes in base64; make one "
            "with: echo whsec_$(openssl rand -base64 32)"
        )
    return key


def signed_headers(key: bytes, message_id: str, seconds: int, body: bytes) -> dict[str, str]:
    """The headers of Standard Webhooks."""
    content = f"{message_id}.{seconds}.".encode() + body
    signature = base64.b64encode(hmac.new(key, content, hashlib.sha256).digest()).decode()
    return {
        "webhook-id": message_id,
        "webhook-timestamp": str(seconds),
        "webhook-signature": f"v1,{signature}",
    }


def verify(key: bytes, headers: Mapping[str, str], body: bytes) -> bool:
    """Whether a receiver may believe the message (its age is for the receiver to judge)."""
    seconds = headers.get("webhook-timestamp", "")
    if not re.fullmatch(r"\d{1,12}", seconds):
        return False
    expected = signed_headers(key, headers.get("webhook-id", ""), int(seconds), body)
    sent = headers.get("webhook-signature", "").split()
    return any(hmac.compare_digest(one, expected["webhook-signature"]) for one in sent)


def next_try(attempt: int, now: float) -> float | None:
    """When a delivery that failed `attempt` times is tried again; None: it is given up."""
    if attempt > len(BACKOFF_S):
        return None
    return now + BACKOFF_S[attempt - 1] * random.uniform(0.9, 1.2)


def refusal(url: str, trusted_hosts: tuple[str, ...]) -> str | None:
    """Why an address cannot be a webhook, as far as that can be told from its text."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        return "it is no address"
    if not host or not url.isascii() or re.search(r"[\s\x00-\x1f\x7f]", url):
        return "it is no address"
    if parts.username or parts.password:
        return "it holds a user name or a password, which would end up in logs"
    if host in trusted_hosts:
        return None if parts.scheme in ("http", "https") else "only http and https are spoken"
    if parts.scheme != "https":
        return "only https is allowed"
    if port not in (None, 443, 8443):
        return "only the ports 443 and 8443 are allowed"
    return None


def is_public(address: str) -> bool:
    """Whether an IP address is on the open internet, also when it wraps an IPv4 address."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        if found in ipaddress.ip_network("64:ff9b::/96"):
            return is_public(str(ipaddress.IPv4Address(int(found) & 0xFFFFFFFF)))
        wrapped = found.ipv4_mapped or found.sixtofour
        if wrapped is not None:
            return is_public(str(wrapped))
        if found.teredo is not None:
            return False
    return found.is_global and not found.is_multicast
