"""Holding on to a job: renews its lease while it gets on, ends the process when it is lost."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from types import TracebackType

import redis

from jobs.records import JobRecords

log = logging.getLogger("worker")

_RENEWALS_PER_LEASE = 4


class LeaseKeeper:
    """A thread beside the fit. Use as a context manager around the work.

    Kills its own process when the record has gone to another attempt, when Redis did not take a
    renewal for a whole lease (another worker may have the job by then), or when the work has not
    called `advance` for stall_s. Whoever waits for the process sorts out what becomes of the job.
    """

    def __init__(self, records: JobRecords, job_id: str, attempt: int, stall_s: float) -> None:
        self._records = records
        self._job_id = job_id
        self._attempt = attempt
        self._stall_s = stall_s
        self._advanced_at = time.monotonic()
        self._renewed_at = time.monotonic()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="lease", daemon=True)

    def advance(self) -> None:
        """The work has got on."""
        self._advanced_at = time.monotonic()

    def __enter__(self) -> LeaseKeeper:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._done.set()
        self._thread.join()

    def _keep(self) -> None:
        while not self._done.wait(self._records.lease_s / _RENEWALS_PER_LEASE):
            reason = self._reason_to_die()
            if reason is not None:
                log.error("%s attempt %d: %s; ending", self._job_id, self._attempt, reason)
                logging.shutdown()
                os.kill(os.getpid(), signal.SIGKILL)

    def _reason_to_die(self) -> str | None:
        if time.monotonic() - self._advanced_at > self._stall_s:
            return f"no progress for {self._stall_s:g} s"
        try:
            if not self._records.renew_lease(self._job_id, self._attempt):
                return "the job is not this attempt's any more"
            self._renewed_at = time.monotonic()
        except redis.RedisError as error:
            log.warning("cannot renew the lease of %s: %s", self._job_id, error)
            if time.monotonic() - self._renewed_at > self._records.lease_s:
                return "Redis is away for longer than the lease"
        return None
