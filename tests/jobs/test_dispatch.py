import json
import zlib
from dataclasses import replace

import pytest
import redis

from jobs.dispatch import QUEUE, TASK, Dispatcher, task_id
from jobs.errors import InvalidMac
from jobs.events import Events
from jobs.ids import new_id
from jobs.records import Idempotency, JobRecords
from jobs.settings import Settings
from jobs.signing import load_secret, sign, verify
from jobs.spec import JobSpec
from jobs.store import FileStore
from jobs.submission import submit


def test_a_task_is_a_name_an_id_and_a_signature(
    dispatcher: Dispatcher, connection: redis.Redis, settings: Settings
) -> None:
    job_id = new_id("job")
    dispatcher.enqueue(job_id, 2)
    with settings.connect_raw() as raw:
        stored = raw.hgetall(f"rq:job:{task_id(job_id, 2)}")
    name, instance, arguments, named = json.loads(zlib.decompress(stored[b"data"]))
    assert (name, instance, named) == (TASK, None, {})
    assert arguments == [job_id, 2, sign(load_secret(settings), job_id, 2)]
    assert int(stored[b"timeout"]) == settings.job_timeout_s  # RQ's own default is 180 s
    assert (stored[b"result_ttl"], stored[b"failure_ttl"]) == (b"0", b"3600")


def test_offering_twice_is_offering_once(dispatcher: Dispatcher, connection: redis.Redis) -> None:
    job_id = new_id("job")
    dispatcher.enqueue(job_id, 1)
    dispatcher.enqueue(job_id, 1)
    dispatcher.enqueue(job_id, 2, first=True)
    waiting = connection.lrange(f"rq:queue:{QUEUE}", 0, -1)
    assert waiting == [task_id(job_id, 2), task_id(job_id, 1)]


def test_a_withdrawn_task_leaves_no_key(dispatcher: Dispatcher, connection: redis.Redis) -> None:
    job_id = new_id("job")
    dispatcher.enqueue(job_id, 1)
    assert dispatcher.is_waiting(job_id, 1)
    dispatcher.withdraw(job_id, 1)
    dispatcher.withdraw(job_id, 1)
    assert not dispatcher.is_waiting(job_id, 1)
    assert connection.keys("*") == ["rq:queues"]


def test_stopping_what_does_not_run_is_harmless(dispatcher: Dispatcher) -> None:
    job_id = new_id("job")
    dispatcher.stop(job_id, 1)
    dispatcher.enqueue(job_id, 1)
    dispatcher.stop(job_id, 1)
    assert dispatcher.is_waiting(job_id, 1)
    assert dispatcher.workers() == 0


def test_signatures_bind_job_and_attempt() -> None:
    job_id = new_id("job")
    mac = sign(b"key", job_id, 1)
    verify(b"key", job_id, 1, mac)
    for secret, job, attempt, text in (
        (b"other", job_id, 1, mac),
        (b"key", new_id("job"), 1, mac),
        (b"key", job_id, 2, mac),
        (b"key", job_id, 1, "ü"),
        (b"key", job_id, 1, ""),
    ):
        with pytest.raises(InvalidMac, match="UDFLOW_SECRET"):
            verify(secret, job, attempt, text)


def test_the_key_is_made_once_and_kept_private(settings: Settings) -> None:
    secret = load_secret(settings)
    assert load_secret(settings) == secret
    assert len(secret) == 64
    assert (settings.data / "secret.key").stat().st_mode & 0o777 == 0o600
    assert load_secret(replace(settings, secret="given")) == b"given"


def test_a_submitted_job_is_on_disk_recorded_and_offered(
    records: JobRecords, store: FileStore, dispatcher: Dispatcher, events: Events
) -> None:
    spec = JobSpec.new(new_id("scan"), {"seed": 1})
    created = submit(spec, records, store, dispatcher)
    assert not created.replayed
    assert store.read_job(spec.id) == spec
    assert dispatcher.is_waiting(spec.id, 1)
    assert [event.data["state"] for event in events.read(spec.id)] == ["queued"]


def test_a_replayed_submission_leaves_no_second_trace(
    records: JobRecords, store: FileStore, dispatcher: Dispatcher, connection: redis.Redis
) -> None:
    key = Idempotency.of("k", 1)
    first = submit(JobSpec.new(new_id("scan"), {}), records, store, dispatcher, idempotency=key)
    again = submit(JobSpec.new(new_id("scan"), {}), records, store, dispatcher, idempotency=key)
    assert again.replayed
    assert again.record == first.record
    assert list(store.jobs()) == [first.record.id]
    assert connection.llen(f"rq:queue:{QUEUE}") == 1
