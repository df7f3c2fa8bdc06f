"""`python -m worker.reaper`: what nobody else is left to do. Any number may run at once.

Jobs whose worker fell silent go back to the queue, canceled ones that do not stop are killed,
waiting ones that RQ lost are offered again, and what has expired is removed.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time

import redis

from jobs.dispatch import Dispatcher
from jobs.logs import configure
from jobs.open_store import open_store
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.signing import load_secret
from jobs.spec import JobRecord, JobState
from jobs.store import FileStore
from udflow import faults
from udflow.errors import UdflowError
from worker.retention import Retention

log = logging.getLogger("reaper")

_CLEAN_PERIOD_S = 30.0
_SUBMITTED_WITHIN_S = 60.0  # a manifest so old has its record, or nobody will make one
_TEMPORARY_PERIOD_S = 3600.0
_TEMPORARY_LIFE_S = 24 * 3600.0


class Reaper:
    """One sweep after the other; all of them can be repeated and run beside each other."""

    def __init__(
        self,
        settings: Settings,
        records: JobRecords,
        dispatcher: Dispatcher,
        store: FileStore,
    ) -> None:
        self._settings = settings
        self._records = records
        self._dispatcher = dispatcher
        self._store = store
        self._retention = Retention(settings, records, store)
        self._undelivered: set[tuple[str, int]] = set()
        self._clean_at = 0.0
        self._temporary_at = 0.0

    def sweep(self) -> None:
        """Everything once. Raises redis.exceptions.RedisError when Redis does not answer."""
        if not self._records.is_restored():
            self.restore()
        for record in self._records.expired_leases():
            self.take_back(record)
        now = self._records.now()
        for record in self._records.active():
            self.press(record, now)
        self.deliver(self._records.queued())
        for record in self._records.unsaved():
            self._store.clear_checkpoints(record.id)
            self._store.write_record(record)
            self._records.mark_saved(record.id)
        for job_id in self._records.past_retention(now):
            self._store.delete_job(job_id)
            self._records.delete(job_id, force=True)
        self._tidy(time.monotonic())

    def restore(self) -> None:
        """Tell a Redis that is empty (new, flushed, its files lost) what the disk knows: ended
        jobs as they ended, all others queued again."""
        for job_id in self._store.jobs():
            self._bring_back(job_id)
        self._records.mark_restored()

    def rescue(self, older_than_s: float = _SUBMITTED_WITHIN_S) -> None:
        """Bring back single jobs that Redis does not know: it lost its last second with the
        power, or the service died while it took the job in."""
        for job_id in self._store.jobs():
            known = self._records.get(job_id) is not None or self._records.is_gone(job_id)
            spec = None if known else self._store.read_job(job_id)
            if spec is not None and spec.created_at < time.time() - older_than_s:
                self._bring_back(job_id)

    def _bring_back(self, job_id: str) -> None:
        ended = self._store.read_record(job_id)
        spec = self._store.read_job(job_id)
        if ended is not None:
            self._records.restore(ended)
        elif spec is not None:
            attempt = self._store.last_attempt(job_id) + 1  # who ran it is shut out by the number
            if not self._records.create(spec, attempt=attempt).replayed:
                log.warning("%s was forgotten by Redis and waits again", job_id)
                self._dispatcher.enqueue(job_id, attempt)

    def take_back(self, record: JobRecord) -> None:
        """Requeue a job whose lease is over."""
        self._dispatcher.stop(record.id, record.attempt)  # should its process still be there
        after = self._records.requeue(
            record.id,
            record.attempt,
            crashed=True,
            only_expired=True,
            why=f"the worker of attempt {record.attempt} was lost; the job goes on elsewhere",
        )
        if after is not None:
            log.warning("%s attempt %d was lost: %s", record.id, record.attempt, after.state)
            self._store.delete_attempt(record.id, record.attempt)
            faults.hit("reaper.requeued")
            self._offer(after)

    def press(self, record: JobRecord, now: float) -> None:
        """Kill a canceled job that has not stopped by itself in time."""
        asked = record.cancel_requested_at
        if record.state is not JobState.CANCELING or asked is None:
            return
        settings = self._settings
        grace_s = settings.partial_grace_s if record.keep_partial else settings.cancel_grace_s
        if now - asked > grace_s:
            log.warning("%s does not stop by itself", record.id)
            self._dispatcher.stop(record.id, record.attempt)

    def deliver(self, waiting: list[JobRecord]) -> None:
        """Offer jobs again that are missing from RQ's queue in two sweeps in a row. (In one, a
        worker may just be taking it. Offering twice is harmless: only one claim succeeds.)"""
        missing: set[tuple[str, int]] = set()
        for record in waiting:
            if self._records.expire_waiting(record.id, self._settings.queue_ttl_s):
                self._dispatcher.withdraw(record.id, record.attempt)
            elif not self._dispatcher.is_waiting(record.id, record.attempt):
                missing.add((record.id, record.attempt))
        for job_id, attempt in missing & self._undelivered:
            log.warning("%s attempt %d was not delivered; offered again", job_id, attempt)
            self._dispatcher.withdraw(job_id, attempt)
            self._dispatcher.enqueue(job_id, attempt)
        self._undelivered = missing

    def _offer(self, record: JobRecord) -> None:
        if record.state is JobState.QUEUED:
            self._dispatcher.enqueue(record.id, record.attempt, first=True)

    def _tidy(self, now: float) -> None:
        if now >= self._clean_at:
            self._dispatcher.clean()
            self._clean_at = now + _CLEAN_PERIOD_S
        if now >= self._temporary_at:
            self._store.sweep_temporary(_TEMPORARY_LIFE_S)
            self._retention.sweep()
            self.rescue()
            self._temporary_at = now + _TEMPORARY_PERIOD_S


def main() -> int:
    """Sweeps until SIGTERM. The exit code."""
    stopping = threading.Event()
    for sig in (signal.SIGTERM, signal.SIGINT):
        signal.signal(sig, lambda *_: stopping.set())
    try:
        configure()
        settings = Settings.from_env()
        reaper = Reaper(
            settings,
            JobRecords(settings.connect(), settings.lease_s),
            Dispatcher(settings.connect_raw(), load_secret(settings), settings.job_timeout_s),
            open_store(settings),
        )
    except UdflowError as error:
        log.error("%s", error)
        return 1
    while not stopping.wait(settings.reaper_period_s):
        try:
            reaper.sweep()
        except redis.RedisError as error:
            log.warning("Redis does not answer: %s", error)
        except OSError as error:
            log.warning("the data folder cannot be used: %s", error)
    return 0


if __name__ == "__main__":
    sys.exit(main())
