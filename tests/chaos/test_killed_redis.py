"""Redis that is killed, emptied or cut off: what was acknowledged is there, and answers come."""

from __future__ import annotations

import random
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import httpx
import pytest
from api_process import Api, ApiProcess, ball
from chaos_kit import SOAK, History, Line, in_background, say, soak_only

from jobs.settings import Settings
from jobs.spec import JobState

SUBMISSIONS, KILLS, CALLERS = (2000, 20, 4) if SOAK else (120, 3, 4)


@pytest.fixture
def api(ground: Any) -> Iterator[Api]:
    log = ground.faults.folder.parent / "api.log"
    limits = {"UDFLOW_QUEUE_LIMIT": "100000"}
    with ApiProcess(ground.shop.settings, log, limits) as running:
        yield running


def submit_until_taken(client: httpx.Client, key: str, scan_id: str) -> tuple[str, int]:
    """The job of a request that is repeated until it is acknowledged, and how often it was."""
    for tries in range(1, 500):
        with suppress(httpx.TransportError):
            body = {"scan_id": scan_id, "metadata": {"key": key}}
            answer = client.post("/v1/jobs", json=body, headers={"Idempotency-Key": key})
            if answer.status_code == 202:
                return str(answer.json()["id"]), tries
            assert answer.status_code == 503, answer.text
            assert answer.json()["code"] == "queue_unavailable"
        time.sleep(0.05)
    raise AssertionError(f"{key} was never taken")


def uploaded(api: Api) -> str:
    answer = httpx.post(f"{api.url}/v1/scans", content=ball(), timeout=30)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def submit_many(api: Api, count: int, history: History) -> int:
    """From several callers at once; how often anything had to be asked again."""
    scan_id, again = uploaded(api), []

    def call(caller: int) -> None:
        with httpx.Client(base_url=api.url, timeout=30) as client:
            for number in range(caller, count, CALLERS):
                job_id, tries = submit_until_taken(client, f"request {number}", scan_id)
                history.acknowledged(f"request {number}", job_id)
                again.append(tries - 1)

    threads = [threading.Thread(target=call, args=(caller,)) for caller in range(CALLERS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(again)


def test_no_acknowledged_job_is_lost_when_redis_is_killed(ground: Any, api: Api) -> None:
    history, chance, kills, again = History(), random.Random(3), 0, []

    def submit(_: threading.Event) -> None:
        again.append(submit_many(api, SUBMISSIONS, history))

    with in_background(submit):  # Redis dies with the thread that started it: it is this one
        while not again and kills < KILLS:
            time.sleep(chance.uniform(0.3, 0.8))
            ground.kill_redis()
            kills += 1
    shop = ground.shop
    assert kills > 1
    assert len(history.jobs()) == SUBMISSIONS
    history.check(shop.records, shop.store, shop.events)
    known = {record.id for record in shop.records.queued()}
    assert known == history.jobs()  # no other either: what was repeated is one job
    for _ in range(2):
        shop.reaper.sweep()
    assert all(shop.dispatcher.is_waiting(job_id, 1) for job_id in history.jobs())
    say(f"{SUBMISSIONS} submissions, {kills} kills of Redis, {again[0]} repeats: none lost")


def test_an_emptied_redis_is_filled_from_the_manifests(ground: Any, api: Api) -> None:
    shop, history = ground.shop, History()
    shop.reaper.sweep()
    submit_many(api, 20, history)
    ended = sorted(history.jobs())[0]
    shop.records.request_cancel(ended)
    shop.reaper.sweep()
    ground.server.stop()
    shutil.rmtree(ground.server._files)  # as a disk that was replaced
    ground.server.start()
    assert shop.records.queued() == []
    shop.reaper.sweep()
    history.check(shop.records, shop.store, shop.events)
    assert shop.get(ended).state is JobState.CANCELED
    assert {record.id for record in shop.records.queued()} == history.jobs() - {ended}
    assert all(shop.dispatcher.is_waiting(record.id, 1) for record in shop.records.queued())
    listed = httpx.get(f"{api.url}/v1/jobs", params={"limit": 100}, timeout=30).json()["jobs"]
    assert {job["id"] for job in listed} == history.jobs()


@soak_only
def test_a_redis_that_falls_silent_is_said_in_bounded_time(ground: Any) -> None:
    line = Line(ground.server._socket.as_posix())
    shared = Settings(data=ground.shop.settings.data, redis_url=f"redis://127.0.0.1:{line.port}/0")
    log = ground.faults.folder.parent / "api.log"
    with ApiProcess(shared, log, {}) as api, httpx.Client(base_url=api.url, timeout=60) as client:
        scan_id = uploaded(api)
        taken = client.post("/v1/jobs", json={"scan_id": scan_id}).json()["id"]
        line.mode = "silent"
        began = time.monotonic()
        answer = client.post("/v1/jobs", json={"scan_id": scan_id})
        silent_s = time.monotonic() - began
        assert (answer.status_code, answer.json()["code"]) == (503, "queue_unavailable")
        assert int(answer.headers["retry-after"]) > 0
        assert client.get(f"/v1/scans/{scan_id}").status_code == 200  # needs no Redis
        line.mode = "pass"
        line.cut()
        job_id, _ = submit_until_taken(client, "later", scan_id)
        assert {taken, job_id} <= {record.id for record in ground.shop.records.queued()}
    line.close()
    assert silent_s < 30.0
    say(f"a silent Redis was said after {silent_s:.1f} s")


def test_an_answer_that_gets_lost_makes_no_second_job(ground: Any, api: Api) -> None:
    line, scan_id = Line(("127.0.0.1", int(api.url.rpartition(":")[2]))), uploaded(api)
    host = {"Host": api.url.removeprefix("http://")}
    address, limits = f"http://127.0.0.1:{line.port}", httpx.Limits(max_keepalive_connections=0)
    with httpx.Client(base_url=address, headers=host, limits=limits, timeout=30) as client:
        line.swallow_answers = 3
        job_id, tries = submit_until_taken(client, "once", scan_id)
    line.close()
    assert tries == 4
    assert [record.id for record in ground.shop.records.queued()] == [job_id]


@soak_only
def test_a_worker_cut_off_from_redis_ends_itself(ground: Any) -> None:
    """Longer than its lease, so that somebody else has its job; it writes nothing any more."""
    shop, line = ground.shop, Line(ground.server._socket.as_posix())
    far = replace(shop.settings, redis_url=f"redis://127.0.0.1:{line.port}/0")
    shop.start_worker(REDIS_URL=far.url)
    job_id = shop.submit({"densify": {"target_points": 100_000, "points_per_round": 100}})
    shop.is_fitting(job_id)
    line.mode = "silent"
    shop.until(lambda: bool(shop.records.expired_leases()), 20.0)
    shop.reaper.sweep()
    assert (shop.get(job_id).attempt, shop.get(job_id).state) == (2, JobState.QUEUED)
    told = len(shop.told(job_id))
    shop.until(lambda: "Redis is away for longer than the lease; ending" in shop.log(), 20.0)
    line.mode = "pass"
    shop.reaches(job_id, JobState.RUNNING, within_s=60.0)
    assert shop.get(job_id).attempt == 2
    assert all(event.data.get("attempt") != 1 for event in shop.told(job_id)[told:])
    shop.records.request_cancel(job_id)
    shop.reaches(job_id, JobState.CANCELED)
    line.close()


@soak_only
def test_redis_may_die_again_and_again_while_jobs_run(ground: Any) -> None:
    shop = ground.shop
    shop.start_worker(UDFLOW_LEASE_S="20")
    jobs = [shop.submit(wanted=("mesh.ply",)) for _ in range(12)]
    history = History()
    for job_id in jobs:
        history.acknowledged(job_id, job_id)
    deadline = time.monotonic() + 900.0
    while not all(shop.get(job_id).is_terminal for job_id in jobs):
        assert time.monotonic() < deadline
        time.sleep(3.0)
        ground.kill_redis(away_s=0.3)
        for _ in range(2):
            shop.reaper.sweep()
    history.check(shop.records, shop.store, shop.events)
    assert {shop.get(job_id).state for job_id in jobs} == {JobState.SUCCEEDED}


def test_a_full_redis_refuses_and_keeps_what_it_has(ground: Any, api: Api) -> None:
    shop, scan_id = ground.shop, uploaded(api)
    taken = shop.submit()
    shop.connection.config_set("maxmemory", 1 << 16)  # it has more already
    try:
        answer = httpx.post(f"{api.url}/v1/jobs", json={"scan_id": scan_id}, timeout=30)
        assert (answer.status_code, answer.json()["code"]) == (503, "queue_unavailable")
        assert shop.get(taken).state is JobState.QUEUED
    finally:
        shop.connection.config_set("maxmemory", 0)
    assert httpx.post(f"{api.url}/v1/jobs", json={"scan_id": scan_id}, timeout=30).is_success
    assert set(shop.store.jobs()) == {record.id for record in shop.records.queued()}
