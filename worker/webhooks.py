"""`python -m worker.webhooks`: sends what `jobs.webhooks` holds. Any number may run at once.

Fits never wait for it, and a receiver that does not answer holds up nobody but itself.
"""

from __future__ import annotations

import http.client
import json
import logging
import signal
import socket
import ssl
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from urllib.parse import urlsplit

import redis

from jobs.ids import is_id
from jobs.logs import configure
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.webhooks import (
    Delivery,
    WebhookQueue,
    event_type,
    is_public,
    message,
    next_try,
    refusal,
    secret_of,
    signed_headers,
)
from udflow.errors import UdflowError

log = logging.getLogger("webhooks")

_PERIOD_S = 0.5
_AT_ONCE = 16
_TIMEOUT_S = 10.0
_LONGEST_S = 15.0  # for everything: an answer that trickles in is none


class NotSent(Exception):
    """Why nothing was sent."""


class Sender:
    """Takes deliveries that are due and sends them, several at once."""

    def __init__(self, settings: Settings) -> None:
        self._key = secret_of(settings.webhook_secret or "")
        self._trusted = settings.webhook_hosts
        connection = settings.connect()
        self._queue = WebhookQueue(connection)
        self._records = JobRecords(connection)
        self._threads = ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="webhook")

    def sweep(self) -> int:
        """Sends everything that is due, waits for it, and says how much that was.

        Raises redis.exceptions.RedisError when Redis does not answer.
        """
        due = self._queue.take(time.time(), _AT_ONCE)
        list(self._threads.map(lambda one: self._deliver(*one), due))
        return len(due)

    def close(self) -> None:
        """Ends the threads."""
        self._threads.shutdown()

    def _deliver(self, job_id: str, state: str) -> None:
        record = self._records.get(job_id) if is_id("job", job_id) else None
        if record is None or record.webhook is None:
            self._queue.forget(job_id, state)
            return
        attempt, now = self._queue.tried(job_id, state) + 1, time.time()
        body = json.dumps(message(record, state)).encode()
        headers = signed_headers(self._key, f"msg_{job_id}_{state}", int(now), body)
        status: int | None = None
        error: str | None = None
        try:
            status = post(record.webhook, body, headers, self._trusted)
        except (NotSent, OSError, http.client.HTTPException) as problem:
            error = str(problem) or type(problem).__name__
        done = status is not None and 200 <= status < 300
        next_at = None if done else next_try(attempt, now)
        if status == 410:  # the receiver wants no more of it
            next_at = None
        event = event_type(state)
        self._queue.settle(job_id, state, Delivery(event, now, attempt, status, error, next_at))
        log.info("%s %s, try %d: %s", job_id, event, attempt, error or status)


def post(url: str, body: bytes, headers: dict[str, str], trusted: tuple[str, ...]) -> int:
    """Sends a message; the status of the answer. Redirects are not followed.

    Raises:
        NotSent: the address is none that may be called.
        OSError, HTTPException: there was no answer.
    """
    if (reason := refusal(url, trusted)) is not None:
        raise NotSent(f"the address was refused: {reason}")
    parts = urlsplit(url)
    host = parts.hostname or ""
    port = parts.port or (443 if parts.scheme == "https" else 80)
    line = _connected(host, port, private=host in trusted)
    cut = threading.Timer(_LONGEST_S, _hang_up, [line])
    cut.daemon = True
    cut.start()
    connection = http.client.HTTPConnection(host, port)
    try:
        if parts.scheme == "https":
            line = ssl.create_default_context().wrap_socket(line, server_hostname=host)
        connection.sock = line
        path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        about = {"Content-Type": "application/json", "User-Agent": "udflow-webhooks"}
        connection.request("POST", path, body, about | headers)
        return connection.getresponse().status
    finally:
        cut.cancel()
        connection.close()
        line.close()


def _connected(host: str, port: int, *, private: bool) -> socket.socket:
    """A connection to an address that was looked at: a name that resolves to another address a
    moment later cannot lead anywhere else."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    addresses = [str(entry[4][0]) for entry in found]
    if not private and not all(map(is_public, addresses)):
        raise NotSent(f"{host} is an address inside this network, which is never called")
    last: OSError | None = None
    for address in addresses[:3]:
        try:
            return socket.create_connection((address, port), timeout=_TIMEOUT_S)
        except OSError as error:
            last = error
    raise last or OSError(f"{host} has no address")


def _hang_up(line: socket.socket) -> None:
    with suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)


def main() -> int:
    """Sends until SIGTERM. The exit code."""
    stopping = threading.Event()
    for sig in (signal.SIGTERM, signal.SIGINT):
        signal.signal(sig, lambda *_: stopping.set())
    try:
        configure()
        sender = Sender(Settings.from_env())
    except UdflowError as error:
        log.error("%s", error)
        return 1
    while not stopping.wait(_PERIOD_S):
        try:
            while sender.sweep() and not stopping.is_set():
                pass
        except redis.RedisError as error:
            log.warning("Redis does not answer: %s", error)
    sender.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
