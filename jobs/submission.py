"""Accepting a job, in the order that loses none."""

from __future__ import annotations

import logging

import redis

from jobs.dispatch import Dispatcher
from jobs.records import Created, Idempotency, JobRecords
from jobs.spec import JobSpec
from jobs.store import FileStore
from udflow import faults

log = logging.getLogger("jobs")


def submit(
    spec: JobSpec,
    records: JobRecords,
    store: FileStore,
    dispatcher: Dispatcher,
    *,
    idempotency: Idempotency | None = None,
    queue_limit: int | None = None,
    caller_limit: int | None = None,
) -> Created:
    """Store the job on disk, then as a record, then offer it to the workers.

    When only the last step fails the reaper repeats it. A job that was there already (the same
    idempotency key) is given back unchanged.

    Raises:
        IdempotencyConflict: the key came before with another body.
        QueueFull: queue_limit jobs wait already.
        TooManyJobs: the spec's caller has caller_limit unfinished ones.
    """
    store.write_job(spec)
    faults.hit("submit.written")
    try:
        created = records.create(spec, idempotency, queue_limit, caller_limit)
    except BaseException:
        store.delete_job(spec.id)
        raise
    faults.hit("submit.recorded")
    if created.record.id != spec.id:
        store.delete_job(spec.id)
    if not created.record.is_terminal:
        try:
            dispatcher.enqueue(created.record.id, created.record.attempt)
        except redis.RedisError as error:
            log.warning("%s is accepted, but not yet offered: %s", created.record.id, error)
    return created
