"""What a user is told about an error, and what becomes of a job whose process died."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from workshop import Workshop

from jobs.dispatch import task_id
from jobs.spec import JobState
from udflow.errors import EmptySurface
from worker import horse
from worker.failure import explain
from worker.rq_worker import AllowedJob, FitWorker, JSONSerializer


def test_errors_of_the_method_keep_code_and_words() -> None:
    told = explain(EmptySurface("nothing at 32 cells; raise extract.resolution"))
    assert (told.code, told.message) == (
        "empty_surface",
        "nothing at 32 cells; raise extract.resolution",
    )


def test_memory_that_torch_cannot_get_is_out_of_memory() -> None:
    with pytest.raises(RuntimeError) as caught:
        torch.empty(1 << 58, dtype=torch.uint8)
    assert explain(caught.value).code == "out_of_memory"
    assert explain(MemoryError()).code == "out_of_memory"


def test_a_full_disk_is_said() -> None:
    assert explain(OSError(errno.ENOSPC, "No space left on device")).code == "storage_full"
    assert explain(OSError(errno.EIO, "Input/output error")).code == "internal"


def test_any_other_error_keeps_its_details_to_the_log(caplog: pytest.LogCaptureFixture) -> None:
    told = explain(KeyError("secret detail"))
    assert told.code == "internal"
    assert "secret" not in told.message
    assert "secret detail" in caplog.text


@pytest.mark.parametrize(
    ("status", "out_of_memory", "longest_s", "state", "code"),
    [
        (9, True, 60.0, JobState.FAILED, "out_of_memory"),  # it would end the same way again
        (9, False, 1e-6, JobState.FAILED, "timeout"),  # so would this
        (9, False, 60.0, JobState.QUEUED, None),
        (11, True, 60.0, JobState.QUEUED, None),  # a crash; the memory was somebody else's
        (0, False, 60.0, JobState.QUEUED, None),  # left without a word
    ],
)
def test_a_dead_process_settles_by_how_it_died(
    own_shop: Workshop,
    status: int,
    out_of_memory: bool,
    longest_s: float,
    state: JobState,
    code: str | None,
) -> None:
    job_id = own_shop.submit()
    worker = FitWorker(replace(own_shop.settings, job_timeout_s=longest_s))
    own_shop.records.claim(job_id, 1, horse.owner_name(worker.name, 12345))
    worker._horse_exit = (12345, status)
    task = AllowedJob.fetch(task_id(job_id, 1), own_shop.raw, JSONSerializer)
    worker._settle(task, out_of_memory=out_of_memory)
    record = own_shop.get(job_id)
    assert record.state is state
    assert (record.error.code if record.error else None) == code
    assert own_shop.dispatcher.is_waiting(job_id, 2) == (state is JobState.QUEUED)


def test_a_job_of_another_process_is_left_alone(own_shop: Workshop) -> None:
    job_id = own_shop.submit()
    worker = FitWorker(own_shop.settings)
    own_shop.records.claim(job_id, 1, "another worker:12345")
    worker._horse_exit = (12345, 9)
    task = AllowedJob.fetch(task_id(job_id, 1), own_shop.raw, JSONSerializer)
    worker._settle(task, out_of_memory=False)
    assert own_shop.get(job_id).state is JobState.RUNNING


def test_a_late_order_to_stop_harms_nobody(
    own_shop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process it was meant for is gone; its number must not be taken for a group."""

    def killed(group: int, _: int) -> None:
        raise AssertionError(f"the group {group} would have been killed")

    monkeypatch.setattr(os, "killpg", killed)
    worker = FitWorker(own_shop.settings)
    worker.kill_horse()
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    worker._horse_pid = child.pid  # forked, and still in the worker's group
    worker.kill_horse()
    assert child.wait(10.0) == -9
    worker.kill_horse()


def test_cores_are_those_that_may_be_used() -> None:
    allowed = os.sched_getaffinity(0)
    assert 1 <= horse.available_cores() <= len(allowed)
