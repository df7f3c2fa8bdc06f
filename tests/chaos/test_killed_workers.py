"""A worker that is killed anywhere: the job ends once, with the mesh of an undisturbed run."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from chaos_kit import SOAK, Faults, check_life, say, soak_only
from shapes import Sphere
from workshop import Workshop, horse_of, is_alive

from jobs.spec import JobRecord, JobState

SOLVED: dict[str, Any] = {
    "flow": {"steps": 2},
    "spline": {"resolution": 16},
    "densify": {"target_points": 300, "points_per_round": 100},
    "extract": {"resolution": 16},
}
TRAINED: dict[str, Any] = {
    "preset": "neural",
    "network": {"layers": 3, "width": 24, "skips": [2], "film": [0]},
    "training": {"iterations": 400, "batch": 300, "queries": 6000, "warmup": 20},
    "densify": {"target_points": 300, "points_per_round": 100},
    "extract": {"resolution": 16},
}
WANTED = ("mesh.ply", "points.ply", "field.safetensors", "report.json")  # pictures take seconds
IN_A_JOB = (
    *("worker.claimed", "worker.step", "file.written", "file.renamed"),
    *("worker.stored", "worker.finished"),
)
IN_A_CHECKPOINT = ("checkpoint.begun", "checkpoint.written", "checkpoint.renamed")
SHORT = (
    "worker.step",
    "checkpoint.written",
    "worker.stored",
)  # of a solved fit; all in `make soak`
RECOVERY_S = 30.0


class Bench:
    """One scan, and what its jobs make when nothing disturbs them."""

    def __init__(self, shop: Workshop, faults: Faults) -> None:
        self.shop, self.faults = shop, faults
        self.scan = shop.scan(Sphere().sample(200).numpy())
        self._undisturbed: dict[str, tuple[dict[str, str], float]] = {}

    def run(self, config: dict[str, Any], state: JobState = JobState.SUCCEEDED) -> JobRecord:
        return self.shop.reaches(self.submit(config), state, within_s=90.0)

    def submit(self, config: dict[str, Any]) -> str:
        return self.shop.submit(config, self.scan, wanted=WANTED)

    def undisturbed(self, config: dict[str, Any]) -> tuple[dict[str, str], float]:
        """Digests of the files, and seconds."""
        key = repr(config)
        if key not in self._undisturbed:
            began = time.monotonic()
            files = digests(self.run(config))
            self._undisturbed[key] = (files, time.monotonic() - began)
        return self._undisturbed[key]

    def check(self, record: JobRecord, config: dict[str, Any], attempts: int = 2) -> None:
        """One life, and the same result as ever; nothing is left over."""
        shop = self.shop
        assert (record.attempt, record.crashes) == (attempts, attempts - 1)
        assert digests(record) == self.undisturbed(config)[0]
        check_life(record.id, shop.records, shop.store, shop.events)
        shop.reaper.sweep()
        folder = shop.store.root / "jobs" / record.id
        wanted = {"job.json", "record.json", "attempt.json", f"a{record.attempt}"}
        # the record ends first; its process may still be tidying up
        shop.until(lambda: {path.name for path in folder.iterdir()} == wanted, 10.0)
        assert shop.temporary_files() == []


def digests(record: JobRecord) -> dict[str, str]:
    """SHA-256 of all files but the report, which tells times."""
    return {name: f.sha256 for name, f in record.outputs.items() if name != "report.json"}


@pytest.fixture(scope="module")
def bench(lasting: Any) -> Bench:
    lasting.shop.start_worker(UDFLOW_CHECKPOINT_S="0.001", **lasting.faults.environ)
    return Bench(lasting.shop, lasting.faults)


@pytest.mark.parametrize("place", IN_A_JOB + IN_A_CHECKPOINT if SOAK else SHORT)
def test_killed_at_every_place_of_a_solved_fit(place: str, bench: Bench) -> None:
    killed_at(place, SOLVED, bench)


@pytest.mark.parametrize("place", IN_A_CHECKPOINT if SOAK else IN_A_CHECKPOINT[2:])
def test_killed_while_training_is_saved(place: str, bench: Bench) -> None:
    killed_at(place, TRAINED, bench)


def killed_at(place: str, config: dict[str, Any], bench: Bench) -> None:
    _, undisturbed_s = bench.undisturbed(config)
    bench.faults.arm(place)
    began = time.monotonic()
    record = bench.run(config)
    assert time.monotonic() - began < 2 * undisturbed_s + RECOVERY_S
    assert bench.faults.armed() == []  # it did strike
    # once the record has ended, nobody is needed any more
    bench.check(record, config, attempts=1 if place == "worker.finished" else 2)


@soak_only
def test_killed_at_random_steps(bench: Bench) -> None:
    costs = kill_at_random(30, bench, random.Random(7))
    say(f"a kill cost {max(costs):.1f} s at most, {sum(costs) / len(costs):.1f} s on average")


def kill_at_random(times: int, bench: Bench, chance: random.Random) -> list[float]:
    """The seconds that each kill cost."""
    costs = []
    for number in range(times):
        config = (SOLVED, TRAINED)[number % 2]
        _, undisturbed_s = bench.undisturbed(config)
        moment = chance.uniform(0.0, 0.9 * undisturbed_s)
        began = time.monotonic()
        job_id = bench.submit(config)
        threading.Timer(moment, bench.faults.arm, ["worker.step"]).start()
        record = bench.shop.reaches(job_id, JobState.SUCCEEDED, within_s=90.0)
        took_s = time.monotonic() - began
        assert took_s - undisturbed_s < RECOVERY_S, f"killed after {moment:.2f} s"
        bench.check(record, config, attempts=1 if bench.faults.armed() else 2)
        bench.faults.disarm()  # the last step was over before it was armed
        costs.append(took_s - undisturbed_s)
    return costs


def test_a_fit_goes_on_where_it_was_and_does_not_begin_anew(bench: Bench) -> None:
    job_id = bench.submit(TRAINED)
    shop = bench.shop
    shop.until(lambda: shop.get(job_id).round >= 1 or shop.get(job_id).is_terminal, 40.0)
    os.kill(horse_of(shop.get(job_id)), signal.SIGKILL)
    record = shop.reaches(job_id, JobState.SUCCEEDED, within_s=60.0)
    bench.check(record, TRAINED)
    fits = [e.data for e in shop.told(job_id) if e.type in ("stage", "progress", "densify")]
    # an attempt that reads for long says so twice: what follows the last time is the second one's
    again = max(i for i, event in enumerate(fits) if event["stage"] == "reading")
    assert any(event["stage"] == "fitting" for event in fits[:again])
    assert all(event["stage"] != "fitting" for event in fits[again:])  # the first fit was done
    assert f"{job_id} attempt 2 goes on from attempt 1" in shop.log()


def test_a_damaged_checkpoint_is_passed_over(bench: Bench) -> None:
    job_id = bench.submit(TRAINED)
    shop = bench.shop
    stored = shop.store.checkpoint_path(job_id, 1)
    shop.until(stored.exists, 40.0)
    horse = horse_of(shop.get(job_id))
    os.kill(horse, signal.SIGSTOP)
    content = bytearray(stored.read_bytes())
    content[len(content) // 2] ^= 4
    stored.write_bytes(content)
    os.kill(horse, signal.SIGKILL)
    record = shop.reaches(job_id, JobState.SUCCEEDED, within_s=60.0)
    bench.check(record, TRAINED)
    assert "checkpoint-a1 is passed over" in shop.log()


@pytest.mark.parametrize("place", IN_A_CHECKPOINT[:2] if SOAK else IN_A_CHECKPOINT[1:2])
def test_a_full_disk_at_a_checkpoint_costs_nothing_else(place: str, bench: Bench) -> None:
    bench.undisturbed(SOLVED)
    bench.faults.arm(place, "ENOSPC")
    record = bench.run(SOLVED)
    assert bench.faults.armed() == []
    bench.check(record, SOLVED, attempts=1)


def test_a_full_disk_at_the_export_is_said_and_harms_nothing(bench: Bench) -> None:
    before = bench.run(SOLVED)
    job_id = bench.submit(SOLVED)
    shop = bench.shop
    shop.until(lambda: (shop.store.root / "jobs" / job_id / "attempt.json").exists(), 20.0)
    bench.faults.arm("file.written", "ENOSPC")
    record = shop.reaches(job_id, JobState.FAILED)
    assert record.error is not None
    assert record.error.code == "storage_full"
    assert "free some space" in record.error.message
    shop.reaper.sweep()
    folder = shop.store.root / "jobs" / job_id
    wanted = {"job.json", "attempt.json", "record.json"}
    # the record ends first; its process may still be tidying up
    shop.until(lambda: {path.name for path in folder.iterdir()} == wanted, 10.0)
    for artifact in before.outputs.values():
        assert shop.store.artifact_path(artifact).stat().st_size == artifact.bytes
    bench.check(bench.run(SOLVED), SOLVED, attempts=1)


def test_a_worker_that_is_shut_down_saves_and_hands_over(ground: Any) -> None:
    shop = ground.shop
    bench = Bench(shop, ground.faults)
    config = TRAINED | {"training": {**TRAINED["training"], "iterations": 600}}
    first = shop.start_worker(UDFLOW_CHECKPOINT_S="1000")
    job_id = bench.submit(config)
    shop.until(lambda: any(e.data.get("step", 0) >= 100 for e in shop.told(job_id)), 60.0)
    horse = horse_of(shop.get(job_id))
    first.terminate()
    assert first.wait(10.0) == 0  # four seconds to save, and a machine that does other things too
    assert not is_alive(horse)
    waiting = shop.get(job_id)
    assert (waiting.state, waiting.attempt, waiting.crashes) == (JobState.QUEUED, 2, 0)
    assert shop.store.checkpoints(job_id, before=2) == [1]  # of the middle of a fit
    assert f"{job_id} attempt 1 is saved for another worker" in shop.log()
    shop.start_worker()
    record = shop.reaches(job_id, JobState.SUCCEEDED, within_s=60.0)
    assert (record.attempt, record.crashes) == (2, 0)
    assert f"{job_id} attempt 2 goes on from attempt 1" in shop.log()
    assert digests(record) == bench.undisturbed(config)[0]


@soak_only
def test_whoever_waits_dies_between_requeue_and_offer(ground: Any) -> None:
    shop, bench = ground.shop, Bench(ground.shop, ground.faults)
    worker = shop.start_worker(**ground.faults.environ)
    bench.undisturbed(SOLVED)
    for place in ("worker.settled", "worker.step"):
        ground.faults.arm(place)
    job_id = bench.submit(SOLVED)
    assert worker.wait(30.0) == -signal.SIGKILL
    goes_on_though_nobody_offered_it(job_id, bench)


@soak_only
def test_a_reaper_dies_between_requeue_and_offer(ground: Any) -> None:
    shop, bench = ground.shop, Bench(ground.shop, ground.faults)
    shop.start_worker()
    bench.undisturbed(SOLVED)
    for worker in shop._workers:
        worker.kill()
    job_id = bench.submit(SOLVED)
    assert shop.records.claim(job_id, 1) is not None  # by a worker of which nothing is left
    ground.faults.arm("reaper.requeued")
    environ = {"REDIS_URL": shop.settings.url, "UDFLOW_DATA": str(shop.settings.data)}
    environ |= ground.faults.environ | {"UDFLOW_REAPER_PERIOD_S": "0.5"}
    reaper = subprocess.Popen([sys.executable, "-m", "worker.reaper"], env=os.environ | environ)
    assert reaper.wait(30.0) == -signal.SIGKILL
    goes_on_though_nobody_offered_it(job_id, bench)


def goes_on_though_nobody_offered_it(job_id: str, bench: Bench) -> None:
    """It waits for its second attempt without a place in the queue, until the reaper sees that."""
    shop = bench.shop
    record = shop.get(job_id)
    assert (record.state, record.attempt) == (JobState.QUEUED, 2)
    assert not shop.dispatcher.is_waiting(job_id, 2)
    for _ in range(2):
        shop.reaper.sweep()
    shop.start_worker()
    bench.check(shop.reaches(job_id, JobState.SUCCEEDED), SOLVED)
