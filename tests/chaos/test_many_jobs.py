"""Many jobs, some of them killed: afterwards everything is as it was before."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from contextlib import suppress
from typing import Any

from chaos_kit import Census, History, in_background, say, soak_only
from shapes import Sphere
from workshop import Workshop, horse_of

from jobs.spec import JobState

JOBS, KILLS, WARM_UP = 500, 30, 10
TINY: dict[str, Any] = {
    "flow": {"steps": 1},
    "spline": {"resolution": 16},
    "densify": {"target_points": 0},
    "extract": {"resolution": 16},
}
MEMORY = 48 << 20  # a worker's heap may settle a little higher than it was


@soak_only
def test_everything_comes_back_to_where_it_was(ground: Any) -> None:
    shop = ground.shop
    workers = [shop.start_worker() for _ in range(2)]
    pids = [worker.pid for worker in workers] + [shop.connection.info("server")["process_id"]]
    scan = shop.scan(Sphere().sample(150).numpy())
    work_off(shop, scan, WARM_UP, 1)
    before = census(shop, pids)
    began = time.monotonic()
    killed = work_off(shop, scan, JOBS, KILLS)
    seconds = time.monotonic() - began
    after = census(shop, pids)
    assert [worker.poll() for worker in workers] == [None] * len(workers)
    assert (after.keys, after.temporary, after.files) == (before.keys, 0, before.files)
    for pid in pids:
        assert after.descriptors[pid] <= before.descriptors[pid] + 2
        assert after.children[pid] == before.children[pid]
        assert after.memory[pid] < before.memory[pid] + MEMORY
    ends = [
        (list(found.descriptors.values()), [size >> 20 for size in found.memory.values()])
        for found in (before, after)
    ]
    say(
        f"{JOBS} jobs, {killed} killed, {seconds:.0f} s: all succeeded, {len(after.keys)} lasting "
        f"keys and {after.files} files as before, descriptors and MB {ends[0]}, then {ends[1]}"
    )


def work_off(shop: Workshop, scan: str, count: int, kills: int) -> int:
    """Runs and deletes jobs, with the reaper beside; how many were killed on the way."""
    history, chance, killed = History(), random.Random(11), []

    def sweep(over: threading.Event) -> None:
        while not over.wait(1.0):
            shop.reaper.sweep()

    def kill(over: threading.Event) -> None:
        while len(killed) < kills and not over.wait(chance.uniform(0.2, 1.0) * count / (kills + 1)):
            with suppress(IndexError, ProcessLookupError, AssertionError):
                running = chance.choice([job for job in shop.records.active() if not job.crashes])
                os.kill(horse_of(running), signal.SIGKILL)
                killed.append(running.id)

    with in_background(sweep), in_background(kill):
        jobs = [shop.submit(TINY, scan, wanted=("mesh.ply",)) for _ in range(count)]
        for job_id in jobs:
            history.acknowledged(job_id, job_id)
            shop.reaches(job_id, JobState.SUCCEEDED, within_s=300.0)
    history.check(shop.records, shop.store, shop.events)
    meshes = {shop.get(job_id).outputs["mesh.ply"].sha256 for job_id in jobs}
    assert len(meshes) == 1
    assert {shop.get(job_id).attempt for job_id in killed} <= {1, 2}
    shop.reaper.sweep()
    for job_id in jobs:
        shop.store.delete_job(job_id)
        assert shop.records.delete(job_id)
    return len(killed)


def census(shop: Workshop, pids: list[int]) -> Census:
    """Once the workers are idle again."""
    shop.until(lambda: not shop.records.active(), 20.0)
    for connection in (shop.connection, shop.raw, shop.dispatcher.connection):
        connection.connection_pool.disconnect()  # this process's own are not counted
    time.sleep(1.0)
    return Census.of(shop.connection, shop.store.root, pids)
