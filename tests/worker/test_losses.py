"""Workers that die, freeze or are shut down: the job ends once, and true."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from workshop import LONG, Workshop, horse_of, is_alive, settings_for, until

from jobs.ids import new_id
from jobs.records import MAX_CRASHES
from jobs.redis_server import EmbeddedRedis
from jobs.spec import JobSpec, JobState


def test_a_killed_process_is_run_again_and_succeeds(shop: Workshop) -> None:
    job_id = shop.submit()
    os.kill(horse_of(shop.is_fitting(job_id)), signal.SIGKILL)
    record = shop.reaches(job_id, JobState.SUCCEEDED)
    assert (record.attempt, record.crashes) == (2, 1)
    assert shop.states(job_id) == ["queued", "running", "queued", "running", "succeeded"]
    warnings = [event.data for event in shop.told(job_id) if event.type == "warning"]
    assert "signal 9" in warnings[0]["message"]
    assert all("/a2/" in artifact.path for artifact in record.outputs.values())
    assert not (shop.store.root / "jobs" / job_id / "a1").exists()
    assert shop.temporary_files() == []


def test_a_job_that_always_dies_is_poison_and_others_run(shop: Workshop) -> None:
    job_id = shop.submit(LONG)
    for attempt in range(1, MAX_CRASHES + 1):
        os.kill(horse_of(shop.is_fitting(job_id, attempt)), signal.SIGABRT)
    record = shop.reaches(job_id, JobState.FAILED)
    assert record.error is not None
    assert (record.error.code, record.crashes) == ("poison", MAX_CRASHES)
    shop.reaches(shop.submit(), JobState.SUCCEEDED)


def test_a_canceled_job_that_does_not_stop_is_killed(shop: Workshop) -> None:
    job_id = shop.submit(LONG)
    horse = horse_of(shop.is_fitting(job_id))
    os.kill(horse, signal.SIGSTOP)  # it cannot look at the flag any more
    shop.records.request_cancel(job_id)
    until(lambda: shop.records.now() - shop.get(job_id).cancel_requested_at > 0.6, 5.0)
    shop.reaper.sweep()
    shop.reaches(job_id, JobState.CANCELED, within_s=8.0)
    assert shop.states(job_id) == ["queued", "running", "canceling", "canceled"]
    until(lambda: not is_alive(horse), 5.0)


def test_a_frozen_process_loses_its_job_and_is_killed(shop: Workshop) -> None:
    job_id = shop.submit()
    horse = horse_of(shop.is_fitting(job_id))
    os.kill(horse, signal.SIGSTOP)
    until(lambda: bool(shop.records.expired_leases()), 10.0)
    shop.reaper.sweep()
    until(lambda: not is_alive(horse), 5.0)
    record = shop.reaches(job_id, JobState.SUCCEEDED)
    assert (record.attempt, record.crashes) == (2, 1)


def test_a_worker_killed_with_its_job_is_replaced(own_shop: Workshop) -> None:
    worker = own_shop.start_worker()
    job_id = own_shop.submit()
    horse = horse_of(own_shop.is_fitting(job_id))
    worker.kill()
    worker.wait()
    until(lambda: not is_alive(horse), 2.0)  # not an orphan that trains on
    assert own_shop.get(job_id).state is JobState.RUNNING
    until(lambda: bool(own_shop.records.expired_leases()), 10.0)
    own_shop.reaper.sweep()
    after = own_shop.get(job_id)
    assert (after.state, after.attempt, after.crashes) == (JobState.QUEUED, 2, 1)

    # a shut-down worker puts its job back uncounted, and leaves at once
    second = own_shop.start_worker()
    own_shop.is_fitting(job_id, attempt=2)
    began = time.monotonic()
    second.terminate()
    assert second.wait(10.0) == 0
    assert time.monotonic() - began < 5.0
    after = own_shop.get(job_id)
    assert (after.state, after.attempt, after.crashes) == (JobState.QUEUED, 3, 1)
    assert own_shop.dispatcher.is_waiting(job_id, 3)
    assert own_shop.connection.scard("rq:workers") == 1  # only the killed one did not sign off


def test_a_redis_that_is_away_for_a_moment_ends_no_fit(tmp_path: Path) -> None:
    server = EmbeddedRedis(tmp_path / "own")
    server.start()
    settings = replace(settings_for(server, tmp_path / "data", 0), lease_s=8.0)
    workshop = Workshop(settings)
    try:
        workshop.start_worker()
        job_id = workshop.submit()
        workshop.is_fitting(job_id)
        os.kill(workshop.connection.info("server")["process_id"], signal.SIGKILL)
        server.stop()
        time.sleep(1.0)
        server.start()
        record = workshop.reaches(job_id, JobState.SUCCEEDED)
        assert (record.attempt, record.crashes) == (1, 0)
        assert workshop.told(job_id)[-1].type == "end"
    finally:
        workshop.close()
        server.stop()


def test_a_task_that_rq_lost_is_offered_again(own_shop: Workshop) -> None:
    spec = JobSpec.new(new_id("scan"), {})
    own_shop.records.create(spec)  # the server died before it could offer the job
    own_shop.reaper.sweep()
    assert not own_shop.dispatcher.is_waiting(spec.id, 1)  # a worker may just be taking it
    own_shop.reaper.sweep()
    assert own_shop.dispatcher.is_waiting(spec.id, 1)
    own_shop.reaper.sweep()
    assert own_shop.connection.llen("rq:queue:udflow") == 1


def test_a_job_that_waits_too_long_expires(own_shop: Workshop) -> None:
    job_id = own_shop.submit()
    own_shop.reaper._settings = replace(own_shop.settings, queue_ttl_s=1e-6)
    own_shop.reaper.sweep()
    record = own_shop.get(job_id)
    assert record.state is JobState.EXPIRED
    assert record.error is not None
    assert record.error.code == "expired"
    assert not own_shop.dispatcher.is_waiting(job_id, 1)


@pytest.mark.parametrize("crashed", [True, False])
def test_two_reapers_take_a_job_once(own_shop: Workshop, crashed: bool) -> None:
    job_id = own_shop.submit()
    own_shop.records.claim(job_id, 1)
    lost = own_shop.get(job_id)
    for _ in range(2):
        own_shop.records.requeue(lost.id, lost.attempt, crashed=crashed, why="lost")
    assert own_shop.get(job_id).attempt == 2
