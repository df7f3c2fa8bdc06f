"""The RQ worker: one forked process a job, one function allowed, and no job left without an end.

RQ's SimpleWorker ignores stop commands and its SpawnWorker pays the import of torch each time, so
this forks. The parent must never run a torch operation or touch CUDA: neither survives a fork.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import redis
from rq import Queue, Worker
from rq.exceptions import DeserializationError, NoSuchJobError
from rq.executions import Execution
from rq.job import Job
from rq.serializers import JSONSerializer
from rq.timeouts import BaseDeathPenalty

from jobs.dispatch import QUEUE, TASK, Dispatcher
from jobs.errors import InvalidMac
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.signing import load_secret, verify
from jobs.spec import JobRecord, JobState
from udflow import faults
from worker import horse, tasks
from worker.failure import OUT_OF_MEMORY, TIMEOUT

log = logging.getLogger("worker")

_HEARTBEAT_TTL_S = 20  # an idle worker shows itself 15 s before this is over
_MONITORING_S = 10  # a busy one every so often
_DRAIN_S = 4.0  # how long a job has to save itself when the worker is shut down

# What a task may bring along. Callbacks, webhooks, retries, repeats, dependencies and results name
# more code to import or addresses to call, so they are dropped before RQ sees them.
_ALLOWED_FIELDS = frozenset(
    b"data created_at origin description enqueued_at started_at ended_at last_heartbeat "
    b"worker_name timeout result_ttl failure_ttl status".split()
)


class NoAlarm(BaseDeathPenalty):
    """RQ's time limit raises from a signal handler. That is not survivable here: SciPy's KD-tree,
    left by an exception, frees arrays that its threads are still filling. The trainer looks at the
    clock between two steps instead, and the parent kills what is a minute over."""

    def setup_death_penalty(self) -> None:
        """No alarm."""

    def cancel_death_penalty(self) -> None:
        """Nothing to cancel."""


class ForbiddenTask(Exception):
    """The queue named something other than the one allowed function."""


class AllowedJob(Job):
    """A task that can only be `worker.tasks.run`. JSON alone is no boundary: RQ would import and
    call whatever dotted name stands in Redis."""

    def restore(self, raw_data: dict[bytes, bytes]) -> Any:
        """Take over what Redis holds, without anything that could run other code.

        Raises:
            NoSuchJobError: it is malformed. RQ passes over such tasks; other errors would end it.
        """
        kept = {name: value for name, value in raw_data.items() if name in _ALLOWED_FIELDS}
        try:
            return super().restore(kept)
        except Exception as error:  # whatever RQ's parsing of foreign bytes may raise
            log.warning("malformed task %s: %s", self.id, error)
            raise NoSuchJobError(f"malformed task: {error}") from error

    @property
    def func(self) -> Callable[..., None]:
        """The allowed function.

        Raises:
            ForbiddenTask: another one was named.
        """
        if self.func_name != TASK or self.instance is not None:
            raise ForbiddenTask(f"only {TASK} may be run, not {str(self.func_name)[:80]!r}")
        return tasks.run


class FitWorker(Worker):
    """Runs jobs until SIGTERM; a job that runs then goes back to the queue."""

    def __init__(self, settings: Settings) -> None:
        connection = settings.connect_raw()
        self._secret = load_secret(settings)
        self._records = JobRecords(settings.connect(), settings.lease_s)
        self._dispatcher = Dispatcher(connection, self._secret, settings.job_timeout_s)
        self._job_timeout_s = settings.job_timeout_s
        self._horse_exit: tuple[int, int] | None = None
        super().__init__(
            [Queue(QUEUE, connection=connection, serializer=JSONSerializer, job_class=AllowedJob)],
            connection=connection,
            serializer=JSONSerializer,
            job_class=AllowedJob,
            worker_ttl=_HEARTBEAT_TTL_S,
            job_monitoring_interval=_MONITORING_S,
            log_job_description=False,
        )

    def main_work_horse(self, job: Job, queue: Queue) -> None:
        """In the forked process."""
        horse.prepare(parent=self.pid or 0)
        self.death_penalty_class = NoAlarm
        super().main_work_horse(job, queue)

    def execute_job(self, job: Job, queue: Queue) -> None:
        """Fork, wait, and see to it that the job does not stay running."""
        kills_before = horse.oom_kills()
        self._horse_exit = None
        super().execute_job(job, queue)
        try:
            self._settle(job, out_of_memory=horse.oom_kills() > kills_before)
        except redis.RedisError as error:
            log.warning("cannot settle %s now, its lease will run out: %s", job.id, error)

    def wait_for_horse(self) -> Any:
        """Remember how the process ended: RQ keeps that to itself."""
        ended = super().wait_for_horse()
        pid, status, _ = ended
        if pid is not None and status is not None:
            self._horse_exit = (pid, status)
        return ended

    def setup_work_horse_signals(self) -> None:
        """In the forked process: SIGTERM asks it to save and end."""
        super().setup_work_horse_signals()  # type: ignore[no-untyped-call]
        signal.signal(signal.SIGTERM, horse.end_soon)

    def handle_warm_shutdown_request(self) -> None:
        """SIGTERM: let the fit save itself, do not wait for its end. `_settle` puts it back."""
        super().handle_warm_shutdown_request()  # type: ignore[no-untyped-call]
        if self.horse_pid:
            self.kill_horse(signal.SIGTERM)
            patience = threading.Timer(_DRAIN_S, self._patience_is_over)
            patience.daemon = True
            patience.start()

    def kill_horse(self, sig: signal.Signals = signal.SIGKILL) -> None:
        """Signal the job's process and what it started. RQ's own takes down this worker with all
        its group when the process is gone already, or has not left the group yet."""
        pid = self.horse_pid
        with suppress(ProcessLookupError):
            if pid and os.getpgid(pid) == os.getpgrp():
                os.kill(pid, sig)
            elif pid:
                os.killpg(os.getpgid(pid), sig)

    def _patience_is_over(self) -> None:
        self.kill_horse()

    def maintain_heartbeats(self, job: Job, execution: Execution) -> None:
        """A Redis that is away for a moment must not end the fit."""
        try:
            super().maintain_heartbeats(job, execution)
        except redis.RedisError as error:
            log.warning("cannot send a heartbeat: %s", error)

    def _settle(self, job: Job, *, out_of_memory: bool) -> None:
        """Decide what becomes of a job whose process ended without ending the job."""
        record = self._unfinished(job)
        if record is None or self._horse_exit is None:
            return
        _, status = self._horse_exit
        killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
        too_long = record.started_at is not None and (
            self._records.now() - record.started_at > self._job_timeout_s
        )
        if killed and (out_of_memory or too_long) and record.state is not JobState.QUEUED:
            error = OUT_OF_MEMORY if out_of_memory else TIMEOUT
            self._records.finish(record.id, record.attempt, JobState.FAILED, error=error)
            return
        why = (
            "the worker was shut down; another one goes on"
            if self._stop_requested
            else f"the process of attempt {record.attempt} died ({_describe(status)}); "
            "the job goes on from its last checkpoint"
        )
        after = self._records.requeue(
            record.id, record.attempt, crashed=not self._stop_requested, why=why
        )
        faults.hit("worker.settled")
        if after is not None and after.state is JobState.QUEUED:
            self._dispatcher.enqueue(after.id, after.attempt, first=True)

    def _unfinished(self, job: Job) -> JobRecord | None:
        """The record of the attempt that just ran here, if it did not end."""
        try:
            job_id, attempt, mac = job.args
            verify(self._secret, job_id, attempt, mac)
        except (InvalidMac, DeserializationError, ValueError, TypeError, AttributeError):
            return None
        record = self._records.get(job_id)
        if record is None or record.attempt != attempt or self._horse_exit is None:
            return None
        pid, status = self._horse_exit
        died_unclaimed = record.state is JobState.QUEUED and status != 0
        ours = not record.is_terminal and record.owner == horse.owner_name(self.name, pid)
        return record if ours or died_unclaimed else None


def _describe(status: int) -> str:
    if os.WIFSIGNALED(status):
        return f"signal {os.WTERMSIG(status)}"
    return f"exit status {os.waitstatus_to_exitcode(status)}"
