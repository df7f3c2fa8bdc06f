"""How fast the service answers while it works: distance queries, and status polls among watchers.

    python benchmarks/http_latency.py                     # starts a service of its own
    python benchmarks/http_latency.py --watchers 200 --fits 2 --save

Three tables: binary queries (points a second), small JSON queries (p50, p99) with and without a fit
running, and status polls (p50, p99) with many open websockets and several fits running.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from common import ROOT, markdown, provenance, provenance_line, save
from websockets.asyncio.client import connect

from jobs.redis_server import EmbeddedRedis
from udflow.client import Client

SMALL = {"densify": {"target_points": 0}, "extract": {"resolution": 64}}
LONG = {  # small steps, so that there is much to tell
    "densify": {"target_points": 400_000, "points_per_round": 500},
    "extract": {"resolution": 64},
}

_ABOUT = """Service, workers, watchers and the asking client share the cores of one machine. Fits
run 10 `nice` levels below the rest, as far as there are any: with `niceness` 19 in the settings
below all are equal, and the figures are upper bounds."""


def main() -> None:
    """Run what the command line asks for."""
    options = _options()
    origin = provenance(
        watchers=options.watchers,
        fits=options.fits,
        polls=options.polls,
        queries=options.queries,
        niceness=os.getpriority(os.PRIO_PROCESS, 0),
    )
    with _service(options.fits) as url, Client(url, timeout_s=120.0) as client:
        rows = list(_measured(client, url, options))
    table = markdown(("what", "beside it", "result"), rows)
    print(table)
    if options.save:
        text = f"# Answers over HTTP\n\n{_ABOUT}\n\n{table}\n{provenance_line(origin)}\n"
        save("http_latency", {**origin, "rows": rows}, text)


def _measured(client: Client, url: str, options: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    job_id = client.submit(_ball(5_000), config=SMALL)["id"]
    client.wait(job_id)
    first = _timed(lambda: client.query(job_id, np.zeros((1, 3))))
    yield "first query, which loads torch and the field", "nothing", f"{first:.1f} s"
    yield "binary query", "nothing", _throughput(client, job_id, options.queries)
    yield "10 points as JSON", "nothing", _small(url, job_id, options.polls)
    fits = [client.submit(_ball(4_000 + i), config=LONG)["id"] for i in range(options.fits)]
    while any(client.job(fit)["stage"] in (None, "reading") for fit in fits):
        time.sleep(0.1)
    beside = f"{options.fits} fits"
    yield "binary query", beside, _throughput(client, job_id, options.queries)
    yield "10 points as JSON", beside, _small(url, job_id, options.polls)
    polls = _polls_among_watchers(url, fits, options)
    yield "status poll", f"{beside}, {options.watchers} websockets", polls
    for fit in fits:
        if client.job(fit)["state"] != "running":
            raise SystemExit("a fit has ended before the measurement; make it longer")
        client.cancel(fit)


def _ball(points: int) -> bytes:
    normals = np.random.default_rng(points).normal(size=(points, 3))
    file = BytesIO()
    np.save(file, normals / np.linalg.norm(normals, axis=1, keepdims=True))
    return file.getvalue()


def _throughput(client: Client, job_id: str, count: int) -> str:
    points = np.random.default_rng(0).uniform(-1, 1, (count, 3))
    began = time.perf_counter()
    client.query(job_id, points)
    return f"{count / (time.perf_counter() - began):,.0f} points/s"


def _small(url: str, job_id: str, count: int) -> str:
    points = np.random.default_rng(1).uniform(-1, 1, (10, 3)).tolist()
    address, question = f"/v1/jobs/{job_id}/udf", {"points": points}
    with httpx.Client(base_url=url, timeout=60) as http:
        return _percentiles(
            _timed(lambda: http.post(address, json=question).raise_for_status())
            for _ in range(count)
        )


def _timed(ask: Callable[[], object]) -> float:
    began = time.perf_counter()
    ask()
    return time.perf_counter() - began


def _polls_among_watchers(url: str, fits: list[str], options: argparse.Namespace) -> str:
    """Status polls while websockets, in a process of their own, take all events of the fits."""
    spawned = multiprocessing.get_context("spawn")
    ours, theirs = spawned.Pipe()
    jobs = [fits[i % len(fits)] for i in range(options.watchers)]
    watchers = spawned.Process(target=_watch, args=(url, jobs, theirs))
    watchers.start()
    ours.recv()  # all are open
    seconds = []
    with httpx.Client(base_url=url, timeout=60) as http:
        for i in range(options.polls):
            address = f"/v1/jobs/{fits[i % len(fits)]}"
            seconds.append(_timed(lambda address=address: http.get(address).raise_for_status()))
            time.sleep(0.01)
    ours.send("enough")
    taken, broken, lasted = ours.recv()
    watchers.join()
    rate = f"{taken / lasted:.0f} events a second taken, {broken} websockets broken"
    return f"{_percentiles(iter(seconds))}; {rate}"


def _watch(url: str, jobs: list[str], told: Connection) -> None:
    """Opens a websocket for each job, says so, and at a word tells what came through them."""

    async def watch(job_id: str, opened: asyncio.Semaphore) -> None:
        nonlocal taken
        address = f"{url.replace('http', 'ws', 1)}/v1/jobs/{job_id}/events"
        async with connect(address, open_timeout=60) as line:
            opened.release()
            async for _ in line:
                taken += 1

    async def all_of_them() -> None:
        opened = asyncio.Semaphore(0)
        tasks = [asyncio.create_task(watch(job_id, opened)) for job_id in jobs]
        for _ in jobs:
            await opened.acquire()
        began, before = time.perf_counter(), taken
        told.send("open")
        await asyncio.to_thread(told.recv)
        lasted = time.perf_counter() - began
        broken = sum(task.done() for task in tasks)
        told.send((taken - before, broken, lasted))
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    taken = 0
    asyncio.run(all_of_them())


def _percentiles(seconds: Iterator[float]) -> str:
    p50, p99 = np.percentile(list(seconds), [50, 99]) * 1000
    return f"p50 {p50:.1f} ms, p99 {p99:.1f} ms"


@contextmanager
def _service(workers: int) -> Iterator[str]:
    """A service of our own, with as many workers as there are fits."""
    with tempfile.TemporaryDirectory(prefix="udflow-bench-") as folder:
        port = _free_port()
        data = Path(folder) / "data"
        known = {"PORT": str(port), "UDFLOW_DATA": str(data)}
        environment = {k: v for k, v in os.environ.items() if k != "REDIS_URL"} | known
        log = (Path(folder) / "log").open("wb")
        parts = [_started([sys.executable, "-m", "service.up"], environment, log)]
        url = f"http://127.0.0.1:{port}"
        try:
            _until_ready(url, parts[0])
            more = environment | {"REDIS_URL": EmbeddedRedis(data.resolve()).url}
            for _ in range(workers - 1):
                parts.append(_started([sys.executable, "-m", "worker"], more, log))
            yield url
        finally:
            for part in reversed(parts):
                part.send_signal(signal.SIGINT if part is parts[0] else signal.SIGTERM)
                part.wait(30)
            log.close()


def _started(command: list[str], environment: dict[str, str], log: Any) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=log, stderr=log, start_new_session=True
    )


def _until_ready(url: str, process: subprocess.Popen[bytes]) -> None:
    for _ in range(900):
        if process.poll() is not None:
            raise SystemExit("the service ended before it was ready")
        try:
            if httpx.get(f"{url}/readyz", timeout=5).status_code == 200:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    raise SystemExit("the service does not become ready")


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--watchers", type=int, default=200, help="open websockets")
    parser.add_argument("--fits", type=int, default=2, help="running beside")
    parser.add_argument("--polls", type=int, default=300, help="requests of each kind")
    parser.add_argument("--queries", type=int, default=1_000_000, help="points of a binary query")
    parser.add_argument("--save", action="store_true", help="write docs/results")
    return parser.parse_args()


if __name__ == "__main__":
    main()
