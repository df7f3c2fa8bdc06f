"""A Redis that has forgotten everything learns it again from the disk."""

from __future__ import annotations

from workshop import Workshop

from jobs.spec import Artifact, JobState


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
