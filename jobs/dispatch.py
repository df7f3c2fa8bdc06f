"""Handing jobs to workers through RQ. Besides the worker itself, only this module knows RQ.

RQ's defaults do not fit a fit and are all overridden: 180 s per job, results kept for 500 s,
failures for a year, pickle. A task is the name of one function and {job id, attempt, HMAC}.
"""

from __future__ import annotations

from contextlib import suppress

import redis
import rq
from rq import worker_registration
from rq.command import send_stop_job_command
from rq.exceptions import DuplicateJobError, InvalidJobOperation, NoSuchJobError
from rq.job import Job
from rq.serializers import JSONSerializer
from rq.utils import as_text, now, utcparse

from jobs.signing import sign

QUEUE = "udflow"
TASK = "worker.tasks.run"
WORKER_SILENCE_S = 15.0  # a worker not heard of for so long is not counted
_FAILURE_TTL_S = 3600


class Dispatcher:
    """connection: with byte answers (`Settings.connect_raw`); secret: from `load_secret`.

    All methods raise redis.exceptions.RedisError when Redis does not answer.
    """

    def __init__(
        self, connection: redis.Redis, secret: bytes, job_timeout_s: float = 4 * 3600.0
    ) -> None:
        self.connection = connection
        self._secret = secret
        self._timeout_s = int(job_timeout_s)
        self._queue = rq.Queue(QUEUE, connection=connection, serializer=JSONSerializer)

    def enqueue(self, job_id: str, attempt: int, *, first: bool = False) -> None:
        """Offer an attempt to the workers; again is harmless. first: before all that wait."""
        with suppress(DuplicateJobError):
            self._queue.enqueue_call(
                TASK,
                args=(job_id, attempt, sign(self._secret, job_id, attempt)),
                job_id=task_id(job_id, attempt),
                description=task_id(job_id, attempt),
                unique=True,
                at_front=first,
                timeout=self._timeout_s,
                result_ttl=0,
                failure_ttl=_FAILURE_TTL_S,
            )

    def is_waiting(self, job_id: str, attempt: int) -> bool:
        """Whether the attempt stands in the queue of RQ."""
        return self._queue.get_job_position(task_id(job_id, attempt)) is not None

    def withdraw(self, job_id: str, attempt: int) -> None:
        """Take an attempt back that no worker has begun. One that has begun is left alone."""
        with suppress(NoSuchJobError):
            job = Job.fetch(
                task_id(job_id, attempt), connection=self.connection, serializer=JSONSerializer
            )
            if not job.is_started:
                job.delete()

    def stop(self, job_id: str, attempt: int) -> None:
        """Kill the process that runs the attempt. Delivery is not certain: repeat until it ends."""
        with suppress(NoSuchJobError, InvalidJobOperation):
            send_stop_job_command(
                self.connection, task_id(job_id, attempt), serializer=JSONSerializer
            )

    def workers(self) -> int:
        """How many workers have lately been heard of."""
        with self.connection.pipeline(transaction=False) as pipe:
            for key in worker_registration.get_keys(queue=self._queue):
                pipe.hget(as_text(key), "last_heartbeat")
            beats = [utcparse(as_text(beat)) for beat in pipe.execute() if beat]
        return sum((now() - beat).total_seconds() < WORKER_SILENCE_S for beat in beats)

    def clean(self) -> None:
        """Let RQ forget executions whose worker is gone."""
        self._queue.started_job_registry.cleanup()


def task_id(job_id: str, attempt: int) -> str:
    """The id of an attempt inside RQ."""
    return f"{job_id}-a{attempt}"
