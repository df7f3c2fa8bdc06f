"""The job records, one behaviour at a time; test_state_machine.py walks them all together."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import redis

from jobs import keys
from jobs.errors import IdempotencyConflict, QueueFull, UnknownId
from jobs.events import Events
from jobs.ids import new_id
from jobs.records import MAX_CRASHES, Idempotency, JobRecords
from jobs.settings import Settings
from jobs.spec import Artifact, JobError, JobSpec, JobState

MESH = {"mesh.ply": Artifact("jobs/x/a1/mesh.ply", 12, "ab" * 32)}


def a_spec(**changes: Any) -> JobSpec:
    return JobSpec.new(new_id("scan"), {"preset": "fast", "seed": 3}, **changes)


def test_a_record_comes_back_as_it_was_stored(records: JobRecords) -> None:
    spec = a_spec(metadata={"name": "Zoë"}, ttl_s=60)
    record = records.create(spec).record
    assert record == records.get(spec.id)
    assert (record.state, record.attempt, record.progress) == (JobState.QUEUED, 1, 0.0)
    assert (record.config, record.metadata) == (spec.config, spec.metadata)
    assert record.loss is record.error is record.eta_s is record.started_at is None


def test_all_fields_survive_an_update(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1, "me", "cuda")
    assert records.update(
        job.id, 1, stage="fitting", progress=0.25, loss=1.25e-9, points=31_000, eta_s=4.5
    )
    found = records.get(job.id)
    assert found is not None
    assert (found.stage, found.progress, found.loss) == ("fitting", 0.25, 1.25e-9)
    assert (found.points, found.eta_s, found.device) == (31_000, 4.5, "cuda")


def test_there_is_no_record_of_an_unknown_job(records: JobRecords) -> None:
    job_id = new_id("job")
    assert records.get(job_id) is None
    assert records.snapshot(job_id) is None
    assert records.request_cancel(job_id) is None
    assert records.claim(job_id, 1) is None
    assert not records.is_gone(job_id)


def test_the_same_request_twice_is_one_job(records: JobRecords) -> None:
    key = Idempotency.of("abc", {"scan": 1})
    first = records.create(a_spec(), key)
    second = records.create(a_spec(), Idempotency.of("abc", {"scan": 1}))
    assert (first.replayed, second.replayed) == (False, True)
    assert second.record == first.record
    assert records.queue_length() == 1


def test_fifty_at_once_are_one_job(settings: Settings) -> None:
    connection = settings.connect()
    records = JobRecords(connection)
    key = Idempotency.of("double click", {})
    with ThreadPoolExecutor(16) as pool:
        made = list(pool.map(lambda _: records.create(a_spec(), key), range(50)))
    assert len({created.record.id for created in made}) == 1
    assert sum(not created.replayed for created in made) == 1
    connection.close()


def test_a_key_belongs_to_one_body(records: JobRecords) -> None:
    records.create(a_spec(), Idempotency.of("abc", {"scan": 1}))
    with pytest.raises(IdempotencyConflict, match="use a new key"):
        records.create(a_spec(), Idempotency.of("abc", {"scan": 2}))
    assert records.queue_length() == 1


def test_a_key_whose_job_was_deleted_makes_no_new_one(records: JobRecords) -> None:
    key = Idempotency.of("abc", {})
    job = records.create(a_spec(), key).record
    assert records.delete(job.id, force=True)
    with pytest.raises(UnknownId, match="deleted"):
        records.create(a_spec(), key)


def test_a_full_queue_refuses(records: JobRecords) -> None:
    records.create(a_spec(), queue_limit=2)
    second = records.create(a_spec(), queue_limit=2).record
    with pytest.raises(QueueFull, match="2 jobs are waiting"):
        records.create(a_spec(), queue_limit=2)
    records.claim(second.id, 1)
    records.create(a_spec(), queue_limit=2)


def test_queue_positions_move_up(records: JobRecords) -> None:
    jobs = [records.create(a_spec()).record for _ in range(3)]
    assert [records.queue_position(job.id) for job in jobs] == [1, 2, 3]
    records.claim(jobs[0].id, 1)
    records.request_cancel(jobs[1].id)
    assert [records.queue_position(job.id) for job in jobs] == [None, None, 1]


def test_only_one_claim_succeeds(settings: Settings) -> None:
    connection = settings.connect()
    records = JobRecords(connection)
    job = records.create(a_spec()).record
    with ThreadPoolExecutor(8) as pool:
        claims = list(pool.map(lambda k: records.claim(job.id, 1, f"w{k}"), range(8)))
    assert sum(claim is not None for claim in claims) == 1
    connection.close()


def test_a_claim_repeated_after_a_lost_reply_is_the_same_claim(
    records: JobRecords, events: Events
) -> None:
    job = records.create(a_spec()).record
    assert records.claim(job.id, 1, "me") == records.claim(job.id, 1, "me")
    assert records.claim(job.id, 1, "another") is None
    assert [event.data["state"] for event in events.read(job.id)] == ["queued", "running"]


def test_a_lost_worker_can_write_nothing(records: JobRecords, events: Events) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1, "lost")
    records.requeue(job.id, 1, crashed=True, why="lost")
    records.claim(job.id, 2, "new")
    before, told = records.get(job.id), events.read(job.id)
    assert not records.update(job.id, 1, ("progress", {"progress": 1}), progress=1.0)
    assert not records.renew_lease(job.id, 1)
    assert records.finish(job.id, 1, JobState.SUCCEEDED, outputs=MESH) is None
    assert records.requeue(job.id, 1, crashed=True, why="again") is None
    assert records.get(job.id) == before
    assert events.read(job.id) == told


def test_success_has_outputs_and_an_end(records: JobRecords) -> None:
    job = records.create(a_spec(ttl_s=100)).record
    records.claim(job.id, 1)
    reached = records.finish(
        job.id, 1, JobState.SUCCEEDED, outputs=MESH, warnings=["3 points dropped"]
    )
    found = records.get(job.id)
    assert found is not None
    assert reached is found.state is JobState.SUCCEEDED
    assert (found.outputs, found.warnings, found.progress) == (MESH, ("3 points dropped",), 1.0)
    assert found.finished_at is not None
    assert found.expires_at == pytest.approx(found.finished_at + 100)


def test_failure_has_an_error_and_no_outputs(records: JobRecords, events: Events) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    error = JobError("empty_surface", 'no "surface" here')
    records.finish(job.id, 1, JobState.FAILED, error=error, outputs=MESH)
    found = records.get(job.id)
    assert found is not None
    assert (found.state, found.error, found.outputs) == (JobState.FAILED, error, {})
    last = events.read(job.id)[-1]
    assert (last.type, last.data["error"]["message"]) == ("end", error.message)


def test_finish_repeated_after_a_lost_reply_changes_nothing(
    records: JobRecords, events: Events
) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    assert records.finish(job.id, 1, JobState.SUCCEEDED, outputs=MESH) is JobState.SUCCEEDED
    told = events.read(job.id)
    assert records.finish(job.id, 1, JobState.FAILED) is JobState.SUCCEEDED
    assert events.read(job.id) == told


def test_cancel_before_the_start_is_final(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    canceled = records.request_cancel(job.id)
    assert canceled is not None
    assert canceled.state is JobState.CANCELED
    assert records.claim(job.id, 1) is None
    assert records.request_cancel(job.id) == canceled


def test_an_acknowledged_cancel_beats_a_success(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    asked = records.request_cancel(job.id)
    assert asked is not None
    assert (asked.state, asked.cancel_requested) == (JobState.CANCELING, True)
    assert records.asked_to_stop(job.id) == "at_once"
    assert records.update(job.id, 1, progress=0.9)  # still ours until it ends
    assert records.finish(job.id, 1, JobState.SUCCEEDED, outputs=MESH) is JobState.CANCELED
    found = records.get(job.id)
    assert found is not None
    assert (found.state, found.outputs) == (JobState.CANCELED, {})


def test_cancel_after_the_end_changes_nothing(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    records.finish(job.id, 1, JobState.SUCCEEDED, outputs=MESH)
    before = records.get(job.id)
    assert records.request_cancel(job.id) == before


def test_a_canceled_job_of_a_lost_worker_ends_canceled(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    records.request_cancel(job.id)
    after = records.requeue(job.id, 1, crashed=True, why="lost")
    assert after is not None
    assert after.state is JobState.CANCELED


def test_three_crashes_are_poison(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    for attempt in range(1, MAX_CRASHES + 1):
        assert records.claim(job.id, attempt) is not None
        after = records.requeue(job.id, attempt, crashed=True, why="died")
        assert after is not None
    assert after.state is JobState.FAILED
    assert after.error is not None
    assert after.error.code == "poison"


def test_a_shutdown_is_no_crash(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    for attempt in range(1, 6):
        records.claim(job.id, attempt)
        after = records.requeue(job.id, attempt, crashed=False, why="shut down")
        assert after is not None
        assert (after.state, after.attempt, after.crashes) == (JobState.QUEUED, attempt + 1, 0)


def test_a_renewed_lease_is_not_taken(records: JobRecords, connection: redis.Redis) -> None:
    job = records.create(a_spec()).record
    records.claim(job.id, 1)
    assert records.expired_leases() == []
    past = JobRecords(connection, lease_s=-1.0)
    past.renew_lease(job.id, 1)
    assert [record.id for record in records.expired_leases()] == [job.id]
    assert records.renew_lease(job.id, 1)  # the worker was only slow
    assert records.requeue(job.id, 1, crashed=True, why="lost", only_expired=True) is None
    past.renew_lease(job.id, 1)
    assert records.requeue(job.id, 1, crashed=True, why="lost", only_expired=True) is not None
    assert records.expired_leases() == []


def test_a_requeued_job_is_the_next_one(records: JobRecords) -> None:
    old = records.create(a_spec()).record
    records.claim(old.id, 1)
    records.create(a_spec())
    records.requeue(old.id, 1, crashed=True, why="lost")
    assert records.queue_position(old.id) == 1


def test_waiting_too_long_ends_as_expired(records: JobRecords) -> None:
    job = records.create(a_spec()).record
    assert not records.expire_waiting(job.id, 1000.0)
    assert records.expire_waiting(job.id, -1.0)
    found = records.get(job.id)
    assert found is not None
    assert found.state is JobState.EXPIRED
    assert not records.expire_waiting(job.id, -1.0)


def test_pages_are_newest_first_and_complete(records: JobRecords) -> None:
    ids = [records.create(a_spec()).record.id for _ in range(7)]
    ids.sort(reverse=True)  # jobs of the same millisecond stand in any order
    seen: list[str] = []
    before: str | None = None
    while True:
        page = records.page(3, before)
        seen += [record.id for record in page.records]
        before = page.next
        if before is None:
            break
    assert seen == ids


def test_pages_filter(records: JobRecords) -> None:
    jobs = [records.create(a_spec()).record for _ in range(4)]
    records.request_cancel(jobs[1].id)
    canceled = records.page(state=JobState.CANCELED).records
    assert [record.id for record in canceled] == [jobs[1].id]
    assert [job.id for job in records.page(scan_id=jobs[2].scan_id).records] == [jobs[2].id]
    assert records.page(created_after=jobs[-1].created_at + 1.0).records == ()
    assert len(records.page(created_after=jobs[0].created_at - 1.0).records) == 4


def test_deleting_leaves_a_tombstone_and_no_other_key(
    records: JobRecords, connection: redis.Redis
) -> None:
    job = records.create(a_spec()).record
    assert not records.delete(job.id)
    records.claim(job.id, 1)
    assert not records.delete(job.id)
    records.finish(job.id, 1, JobState.SUCCEEDED)
    assert records.delete(job.id)
    assert records.delete(job.id)  # idempotent
    assert records.get(job.id) is None
    assert records.is_gone(job.id)
    assert set(connection.keys("*")) == {keys.tombstone(job.id), keys.COUNTERS}


def test_every_key_of_a_finished_job_ends_some_day(
    records: JobRecords, connection: redis.Redis
) -> None:
    job = records.create(a_spec(), Idempotency.of("k", 1)).record
    records.claim(job.id, 1)
    records.finish(job.id, 1, JobState.SUCCEEDED)
    swept = {keys.INDEX, keys.EXPIRING, keys.UNSAVED, keys.COUNTERS}  # by the reaper; one for all
    lasting = {key for key in connection.keys("*") if connection.ttl(key) < 0}
    assert lasting == swept
    assert records.past_retention(records.now()) == []
    assert records.past_retention(records.now() + job.ttl_s + 1.0) == [job.id]
