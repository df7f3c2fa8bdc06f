"""A Redis that has forgotten everything learns it again from the disk."""

from __future__ import annotations

from dataclasses import replace

from shapes import Sphere
from workshop import LONG, QUICK, Workshop, horse_of, is_alive, until

from jobs.spec import Artifact, JobSpec, JobState

SPHERE = Sphere().sample(200).numpy()


def test_jobs_come_back_as_they_were_or_wait_again(own_shop: Workshop) -> None:
    waiting, running, finished, canceled, deleted = (own_shop.submit() for _ in range(5))
    own_shop.records.claim(running, 1)
    own_shop.records.claim(finished, 1)
    mesh = {"mesh.ply": Artifact(f"jobs/{finished}/a1/mesh.ply", 3, "ab" * 32)}
    own_shop.records.finish(finished, 1, JobState.SUCCEEDED, outputs=mesh, warnings=["w"])
    own_shop.records.request_cancel(canceled)
    own_shop.records.delete(deleted, force=True)
    own_shop.store.delete_job(deleted)
    own_shop.reaper.sweep()
    before = {job_id: own_shop.get(job_id) for job_id in (finished, canceled)}

    own_shop.connection.flushdb()
    own_shop.reaper.sweep()
    assert {job_id: own_shop.get(job_id) for job_id in before} == before
    assert own_shop.records.get(deleted) is None
    for job_id in (waiting, running):
        assert own_shop.get(job_id).state is JobState.QUEUED
        assert own_shop.dispatcher.is_waiting(job_id, 1)
    assert [event.type for event in own_shop.told(finished)] == ["state", "end"]
    assert own_shop.records.past_retention(own_shop.records.now() + 1e9) != []
    assert not own_shop.records.update(running, 2, progress=0.5)


def test_nothing_comes_back_while_redis_remembers(own_shop: Workshop) -> None:
    own_shop.reaper.sweep()
    job_id = own_shop.submit()
    own_shop.records.delete(job_id, force=True)  # its files are about to follow
    own_shop.reaper.sweep()
    assert own_shop.records.get(job_id) is None


def test_a_job_that_was_running_comes_back_under_another_number(own_shop: Workshop) -> None:
    worker, running = own_shop.start_worker(), own_shop.submit(LONG)
    horse = horse_of(own_shop.is_fitting(running))
    own_shop.connection.flushdb()
    own_shop.reaper.sweep()
    assert (own_shop.get(running).state, own_shop.get(running).attempt) == (JobState.QUEUED, 2)
    assert not own_shop.records.renew_lease(running, 1)
    until(lambda: not is_alive(horse), 10.0)  # it hears at its next report that it was shut out
    own_shop.reaches(running, JobState.RUNNING, within_s=20.0)
    assert horse_of(own_shop.get(running)) != horse
    worker.kill()


def test_a_manifest_without_a_record_is_an_accepted_job(own_shop: Workshop) -> None:
    own_shop.reaper.sweep()
    lost, fresh, deleted = (JobSpec.new(own_shop.scan(SPHERE), QUICK) for _ in range(3))
    lost = replace(lost, created_at=lost.created_at - 61.0)
    deleted = replace(deleted, created_at=deleted.created_at - 61.0)
    for spec in (lost, fresh, deleted):
        own_shop.store.write_job(spec)
    own_shop.records.create(deleted)
    own_shop.records.delete(deleted.id, force=True)
    own_shop.reaper.rescue()
    assert [record.id for record in own_shop.records.queued()] == [lost.id]
    assert own_shop.dispatcher.is_waiting(lost.id, 1)
