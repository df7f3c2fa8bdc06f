"""An API that is killed while scans and jobs come in: nothing acknowledged is lost, and what was
under way goes on."""

from __future__ import annotations

import hashlib
import io
import random
import resource
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import pytest
from api_process import ApiProcess, ball
from chaos_kit import SOAK, History, say

TUS = {"Tus-Resumable": "1.0.0"}
CHUNK = TUS | {"Content-Type": "application/offset+octet-stream"}
PIECE = 64 << 10
POINTS, KILLS = (400_000, 20) if SOAK else (60_000, 2)
PLACES = ("submit.written", "submit.recorded", "scan.moved", "scan.written", "file.written")
SHORT = ("submit.recorded",)


@dataclass
class Front:
    """An API that is started again whenever it was killed, as `make up` does."""

    ground: Any
    starts: int = 0
    url: str = ""
    process: subprocess.Popen[bytes] | None = None
    _api: Any = field(default=None, repr=False)

    def start(self) -> None:
        self.starts += 1
        folder = self.ground.faults.folder.parent
        environ = self.ground.faults.environ
        self._api = ApiProcess(self.ground.shop.settings, folder / f"api{self.starts}.log", environ)
        self.url = self._api.__enter__().url
        self.process = self._api._process

    def kill(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def again(self, ask: Callable[[str], httpx.Response]) -> httpx.Response:
        """Ask until there is an answer; an API that is gone is started."""
        while True:
            with suppress(httpx.TransportError):
                return ask(self.url)
            assert self.process is not None
            self.process.wait(20)
            self.start()


@contextmanager
def front_of(ground: Any) -> Iterator[Front]:
    front = Front(ground)
    front.start()
    yield front
    if front.process is not None and front.process.poll() is None:
        front._api.__exit__()


@pytest.fixture
def front(ground: Any) -> Iterator[Front]:
    with front_of(ground) as found:
        yield found


def cloud(points: int) -> bytes:
    file = io.BytesIO()
    np.save(file, np.random.default_rng(1).normal(size=(points, 3)))
    return file.getvalue()


def test_an_upload_goes_on_after_every_kill(front: Front) -> None:
    content, chance = cloud(POINTS), random.Random(5)
    began = TUS | {"Upload-Length": str(len(content))}
    made = front.again(lambda url: httpx.post(f"{url}/v1/uploads", headers=began))
    address, offset, kills = made.headers["location"], 0, 0
    pieces = range(0, len(content), PIECE)
    doomed = set(chance.sample(range(1, len(pieces)), KILLS))
    while offset < len(content):
        number = offset // PIECE
        if number in doomed:
            doomed.remove(number)
            kills += 1
            if kills % 2:
                front.ground.faults.arm("upload.appended")  # on disk, but nobody heard so
            else:  # somewhere inside
                threading.Timer(chance.uniform(0, 0.01), front.kill).start()
        with suppress(httpx.TransportError):
            sent = httpx.patch(
                front.url + address,
                headers=CHUNK | {"Upload-Offset": str(offset)},
                content=content[offset : offset + PIECE],
                timeout=30,
            )
            assert sent.status_code in (204, 409), sent.text
        told = front.again(lambda url: httpx.head(url + address, headers=TUS, timeout=30))
        offset = int(told.headers["upload-offset"])
    state = front.again(lambda url: httpx.get(url + address, timeout=60)).json()
    scan, store = state["scan"]["id"], front.ground.shop.store
    assert store.scan_path(scan).read_bytes() == content
    assert store.read_scan(scan)["sha256"] == hashlib.sha256(content).hexdigest()
    assert front.starts == 1 + KILLS
    say(f"{len(content) >> 20} MB uploaded in spite of {KILLS} kills of the API, bytes equal")


@pytest.mark.parametrize("place", PLACES if SOAK else SHORT)
def test_a_request_that_killed_the_api_is_made_again(place: str, front: Front) -> None:
    ground, history = front.ground, History()
    shop = ground.shop
    shop.reaper.sweep()
    ground.faults.arm(place)
    files, key = {"file": ("ball.npy", ball())}, {"Idempotency-Key": "once"}
    for _ in range(2):  # and once more for those who did not hear
        answer = front.again(
            lambda url: httpx.post(f"{url}/v1/jobs", files=files, headers=key, timeout=30)
        )
        assert answer.status_code == 202, answer.text
        history.acknowledged("once", answer.json()["id"])
    assert (front.starts, ground.faults.armed()) == (2, [])
    history.check(shop.records, shop.store, shop.events)
    (job_id,) = history.jobs()
    for _ in range(2):
        shop.reaper.sweep()
    assert shop.dispatcher.is_waiting(job_id, 1)
    shop.reaper.rescue(older_than_s=0.0)  # a manifest that nobody was told of is a job, too
    assert len(list(shop.store.jobs())) == len(shop.records.page(100).records)


def test_a_disk_that_is_full_during_an_upload(front: Front) -> None:
    """Files may not grow beyond 256 KB: the kernel refuses writes as on a full disk."""
    content, small = cloud(20_000), ball()
    kept = httpx.post(f"{front.url}/v1/scans", content=small, timeout=30).json()["id"]
    assert front.process is not None
    resource.prlimit(front.process.pid, resource.RLIMIT_FSIZE, (256 << 10, -1))
    began = TUS | {"Upload-Length": str(len(content))}
    address = httpx.post(f"{front.url}/v1/uploads", headers=began).headers["location"]
    answers = [
        httpx.post(f"{front.url}/v1/scans", content=content, timeout=30),
        httpx.post(f"{front.url}/v1/jobs", files={"file": ("a.npy", content)}, timeout=30),
        httpx.patch(
            front.url + address, headers=CHUNK | {"Upload-Offset": "0"}, content=content, timeout=30
        ),
    ]
    assert [(a.status_code, a.json()["code"]) for a in answers] == [(507, "storage_full")] * 3
    store = front.ground.shop.store
    assert store.scan_path(kept).read_bytes() == small
    assert list(store.scans()) == [kept]
    assert list((store.root / "incoming").iterdir()) == []
    resource.prlimit(front.process.pid, resource.RLIMIT_FSIZE, (-1, -1))
    offset = int(httpx.head(front.url + address, headers=TUS).headers["upload-offset"])
    assert 0 <= offset <= 256 << 10
    rest = {"headers": CHUNK | {"Upload-Offset": str(offset)}, "content": content[offset:]}
    done = httpx.patch(front.url + address, timeout=60, **rest)
    assert done.status_code == 204, done.text
    scan = done.headers["upload-scan"].rpartition("/")[2]
    assert store.scan_path(scan).read_bytes() == content
