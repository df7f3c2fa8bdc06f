"""What of the progress is told, how often, and when."""

from __future__ import annotations

from dataclasses import replace

import pytest
import redis
from workshop import Workshop

from jobs.records import JobRecords
from jobs.spec import JobRecord
from udflow.errors import Canceled
from udflow.progress import Progress
from worker.estimate import TimeLeft
from worker.reporter import JobLost, Reporter

FITTING = Progress("fitting", 0, 1000, 0.0, 0.0, 100)


@pytest.fixture
def job(own_shop: Workshop) -> JobRecord:
    """A running one."""
    job_id = own_shop.submit()
    own_shop.records.claim(job_id, 1)
    return own_shop.get(job_id)


def test_progress_is_thinned_out_and_changes_are_not(own_shop: Workshop, job: JobRecord) -> None:
    reporter = Reporter(own_shop.records, job)
    for step in range(1000):
        reporter.report(replace(FITTING, step=step, round=step // 100, rounds=10), step / 1000)
    told = own_shop.told(job.id)
    assert [e.data["round"] for e in told if e.type == "densify"] == list(range(1, 10))
    assert [e.data["stage"] for e in told if e.type == "stage"] == ["fitting"]
    assert len([e for e in told if e.type == "progress"]) < 20


def test_writing_files_forgets_nothing_of_the_fit(own_shop: Workshop, job: JobRecord) -> None:
    reporter = Reporter(own_shop.records, job)
    reporter.report(replace(FITTING, round=2, rounds=2, loss=0.5), 0.9)
    reporter.report_files(0, 7, 0.95)
    found = own_shop.get(job.id)
    assert (found.stage, found.round, found.loss, found.points) == ("exporting", 2, 0.5, 100)


def test_a_cancel_is_seen(own_shop: Workshop, job: JobRecord) -> None:
    reporter = Reporter(own_shop.records, job)
    reporter.report(FITTING, 0.0)
    own_shop.records.request_cancel(job.id)
    with pytest.raises(Canceled):
        reporter.report(replace(FITTING, stage="extracting"), 0.5)


def test_a_lost_job_is_seen(own_shop: Workshop, job: JobRecord) -> None:
    reporter = Reporter(own_shop.records, job)
    own_shop.records.requeue(job.id, 1, crashed=True, why="taken")
    with pytest.raises(JobLost):
        reporter.report(FITTING, 0.0)


def test_what_redis_missed_is_told_when_it_is_back(own_shop: Workshop, job: JobRecord) -> None:
    kwargs = own_shop.connection.connection_pool.connection_kwargs
    nowhere = redis.Redis(unix_socket_path=kwargs["path"] + ".away", retry=None)
    reporter = Reporter(JobRecords(nowhere), job)
    reporter.report(FITTING, 0.0)  # no error: the fit goes on
    reporter.report(replace(FITTING, round=1, rounds=2), 0.2)
    reporter._records = own_shop.records
    reporter.report(replace(FITTING, round=2, rounds=2), 0.4)
    told = [(e.type, e.data["round"]) for e in own_shop.told(job.id) if e.type != "state"]
    assert told == [("stage", 0), ("densify", 1), ("densify", 2)]
    assert own_shop.get(job.id).progress == 0.4


def test_time_left_is_told_once_it_is_steady() -> None:
    left = TimeLeft()
    steady = [left.update(0.1 * k, 0.1 * k / 20.0) for k in range(1, 200)]
    assert set(steady[:14]) == {None}
    known = [(k, s) for k, s in enumerate(steady, start=1) if s is not None]
    assert known[0][0] < 25
    assert all(abs(s - (20.0 - 0.1 * k)) < 0.2 for k, s in known)


def test_time_left_is_not_told_while_guesses_jump() -> None:
    left = TimeLeft()
    jumping = [left.update(10.0 + k, 0.1 if k % 2 else 0.9) for k in range(20)]
    assert set(jumping) == {None}
