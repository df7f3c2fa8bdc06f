"""A process that must not work on kills itself."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

from workshop import Workshop, until

from jobs.spec import JobState

PROGRAM = """
import sys, time
from jobs.records import JobRecords
from jobs.settings import Settings
from worker.lease import LeaseKeeper
job_id, stall_s = sys.argv[1], float(sys.argv[2])
settings = Settings.from_env()
records = JobRecords(settings.connect(), settings.lease_s)
records.claim(job_id, 1)
with LeaseKeeper(records, job_id, 1, stall_s) as lease:
    print("working", flush=True)
    for _ in range(int(sys.argv[3])):
        time.sleep(0.1)
        lease.advance()
    time.sleep(float(sys.argv[4]))
print("done", flush=True)
"""


def working(
    shop: Workshop, job_id: str, stall_s: float, steps: int, hang_s: float
) -> subprocess.Popen[str]:
    """A process that claims the job, advances every 0.1 s, then hangs."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, job_id, str(stall_s), str(steps), str(hang_s)],
        env={"REDIS_URL": shop.settings.url, "UDFLOW_LEASE_S": "0.8"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "working\n"
    return process


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and what else it said."""
    with process:
        try:
            said, _ = process.communicate(timeout=15.0)
        finally:
            process.kill()
    return process.returncode, said


def test_a_lease_is_kept_while_the_work_advances(own_shop: Workshop) -> None:
    job_id = own_shop.submit()
    process = working(own_shop, job_id, stall_s=1.0, steps=20, hang_s=0.0)
    while process.poll() is None:
        assert own_shop.records.expired_leases() == []
        time.sleep(0.02)
    assert ended(process) == (0, "done\n")


def test_hung_work_is_ended(own_shop: Workshop) -> None:
    job_id = own_shop.submit()
    process = working(own_shop, job_id, stall_s=0.5, steps=0, hang_s=60.0)
    assert ended(process) == (-signal.SIGKILL, "")
    until(lambda: bool(own_shop.records.expired_leases()), 5.0)


def test_work_whose_job_was_taken_is_ended(own_shop: Workshop) -> None:
    job_id = own_shop.submit()
    process = working(own_shop, job_id, stall_s=60.0, steps=600, hang_s=0.0)
    own_shop.records.requeue(job_id, 1, crashed=True, why="taken")
    assert ended(process) == (-signal.SIGKILL, "")
    assert own_shop.get(job_id).state is JobState.QUEUED
