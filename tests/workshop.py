"""A workshop: real worker processes on a real Redis, jobs on small real clouds."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from shapes import Sphere

from jobs.dispatch import Dispatcher
from jobs.events import Event, Events
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from jobs.signing import load_secret
from jobs.spec import JobRecord, JobSpec, JobState
from jobs.store import FileStore
from jobs.submission import submit
from worker.reaper import Reaper

QUICK: dict[str, Any] = {
    "flow": {"steps": 2},
    "spline": {"resolution": 16},
    "densify": {"target_points": 0},
    "extract": {"resolution": 24},
}
LONG: dict[str, Any] = {"densify": {"target_points": 100_000, "points_per_round": 100}}


class Workshop:
    """One data folder with its Redis database, and the processes that work on it."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.connection = settings.connect()
        self.raw = settings.connect_raw()
        self.records = JobRecords(self.connection, settings.lease_s)
        self.events = Events(self.connection)
        self.store = FileStore(settings.data)
        self.dispatcher = Dispatcher(self.raw, load_secret(settings), settings.job_timeout_s)
        self.reaper = Reaper(settings, self.records, self.dispatcher, self.store)
        self._workers: list[subprocess.Popen[str]] = []
        self._logs = settings.data / "logs"
        self._logs.mkdir(exist_ok=True)

    def start_worker(self, **more: str) -> subprocess.Popen[str]:
        """`python -m worker`, ready to take jobs. more: of its environment."""
        environ = {
            "REDIS_URL": self.settings.url,
            "UDFLOW_DATA": str(self.settings.data),
            "UDFLOW_LEASE_S": str(self.settings.lease_s),
            "UDFLOW_STALL_S": str(self.settings.stall_s),
            "OMP_NUM_THREADS": "1",
        }
        path = self._logs / f"worker{len(self._workers)}.log"
        with path.open("w") as log:
            worker = subprocess.Popen(
                [sys.executable, "-m", "worker"],
                env=dict(os.environ) | environ | more,
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
            )
        self._workers.append(worker)
        self.until(lambda: "Listening on" in path.read_text(), 60.0)
        return worker

    def log(self) -> str:
        """What the workers have said."""
        return "".join(path.read_text() for path in sorted(self._logs.iterdir()))

    def scan(self, points: Any) -> str:
        """The id of a new scan, unlike any other."""
        unlike = np.append(points, points[:1] + np.random.default_rng().normal(0, 1e-9, 3), axis=0)
        with self.store.receive() as upload:
            upload.write("\n".join(" ".join(map(repr, row)) for row in unlike.tolist()).encode())
            return self.store.add_scan(upload, {}).id

    def submit(
        self, config: dict[str, Any] = QUICK, scan_id: str | None = None, **more: Any
    ) -> str:
        """The id of a new job, by default on a sphere. more: of its specification."""
        scan = scan_id or self.scan(Sphere().sample(800).numpy())
        spec = JobSpec.new(scan, config, **more)
        return submit(spec, self.records, self.store, self.dispatcher).record.id

    def get(self, job_id: str) -> JobRecord:
        """The record, which must exist."""
        record = self.records.get(job_id)
        assert record is not None
        return record

    def reaches(self, job_id: str, *states: JobState, within_s: float = 40.0) -> JobRecord:
        """The record once it is in one of the states; any end that is not wanted fails."""

        def there() -> bool:
            record = self.get(job_id)
            assert record.state in states or not record.is_terminal, f"{record}\n{self.log()}"
            return record.state in states

        self.until(there, within_s)
        return self.get(job_id)

    def is_fitting(self, job_id: str, attempt: int = 1) -> JobRecord:
        """The record once the attempt's fit is under way."""
        self.until(
            lambda: (
                self.get(job_id).attempt == attempt
                and self.get(job_id).stage in ("fitting", "densifying")
            ),
            40.0,
        )
        return self.get(job_id)

    def until(self, condition: Callable[[], bool], within_s: float) -> None:
        """As `until`, and shows what the workers have said."""
        try:
            until(condition, within_s)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.log()[-4000:]}") from None

    def told(self, job_id: str) -> list[Event]:
        """All its events."""
        return self.events.read(job_id, count=5000)

    def states(self, job_id: str) -> list[str]:
        """The states it went through."""
        return [event.data["state"] for event in self.told(job_id) if event.type == "state"]

    def temporary_files(self) -> list[Path]:
        """What an unfinished write has left."""
        return [path for path in self.store.root.rglob(".part-*") if path.is_file()]

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.terminate()
        for worker in self._workers:
            try:
                worker.wait(10.0)
            except subprocess.TimeoutExpired:
                worker.kill()
                worker.wait()
        self.connection.close()
        self.raw.close()


def until(condition: Callable[[], bool], within_s: float) -> None:
    """Wait for something; fails when it does not come true in time."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {within_s:g} s"
        time.sleep(0.02)


def horse_of(record: JobRecord) -> int:
    """The pid of the process that runs a job."""
    assert record.owner is not None
    return int(record.owner.rpartition(":")[2])


def is_alive(pid: int) -> bool:
    """Whether the process runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def settings_for(server: EmbeddedRedis, data: Path, database: int) -> Settings:
    """Short leases, so that tests need not wait long for them to pass."""
    return Settings(
        data=data,
        redis_url=f"{server.url}?db={database}",
        lease_s=2.0,
        cancel_grace_s=0.5,
        stall_s=60.0,
    )
