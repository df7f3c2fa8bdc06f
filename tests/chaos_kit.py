"""Tools of the chaos tests: faults at named places, a line that misbehaves, a history to check,
a census of what a service holds."""

from __future__ import annotations

import itertools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest
import redis

from jobs.events import Events
from jobs.records import JobRecords
from jobs.spec import TERMINAL, JobState
from jobs.store import FileStore
from udflow.faults import PLACES

SOAK = os.environ.get("SOAK")  # `make soak`: everything, and for long; a file for the figures
soak_only = pytest.mark.skipif(not SOAK, reason="takes its time; make soak runs it")

# what may follow what; a state that is not here is final
_AFTER = {
    "queued": {"running", "canceled", "expired", "failed", "queued"},
    "running": {"succeeded", "failed", "canceling", "queued"},
    "canceling": {"canceled"},
}


def say(figure: str) -> None:
    """A sentence for whoever runs `make soak`."""
    if SOAK:
        with Path(SOAK).open("a") as file:
            file.write(f"{figure}\n")


@dataclass(frozen=True)
class Faults:
    """A folder of armed places; `environ` switches them on in a child process."""

    folder: Path

    @property
    def environ(self) -> dict[str, str]:
        return {"UDFLOW_FAULTS": str(self.folder)}

    def arm(self, place: str, what: str = "") -> None:
        """what: "" kills, the name of an error raises it."""
        assert place in PLACES, place
        (self.folder / place).write_text(what)

    def armed(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())

    def disarm(self) -> None:
        for path in self.folder.iterdir():
            path.unlink()


class Line:
    """A TCP port that leads to an address, and can be cut, silenced, slowed or made to swallow
    answers.

    target: ("127.0.0.1", port) or the path of a unix socket.
    """

    def __init__(self, target: tuple[str, int] | str) -> None:
        self._target = target
        self._open: list[socket.socket] = []
        self._lock = threading.Lock()
        self.mode: Literal["pass", "silent", "refuse"] = "pass"
        self.delay_s = 0.0
        self.swallow_answers = 0  # connections that are cut when the next answers come
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Reset every connection that is open."""
        with self._lock:
            sockets, self._open = self._open, []
        for one in sockets:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def close(self) -> None:
        """Listen no more."""
        self.mode = "refuse"
        self._listener.close()
        self.cut()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
                if self.mode == "refuse":
                    near.close()
                    continue
                far = self._connected()
            except OSError:
                if self._listener.fileno() < 0:
                    return
                near.close()
                continue
            with self._lock:
                self._open += [near, far]
            for source, sink, answers in ((near, far, False), (far, near, True)):
                threading.Thread(
                    target=self._pump, args=(source, sink, answers), daemon=True
                ).start()

    def _connected(self) -> socket.socket:
        if isinstance(self._target, str):
            far = socket.socket(socket.AF_UNIX)
            far.connect(self._target)
            return far
        return socket.create_connection(self._target)

    def _pump(self, source: socket.socket, sink: socket.socket, answers: bool) -> None:
        with suppress(OSError):
            while piece := source.recv(1 << 16):
                time.sleep(self.delay_s)
                while self.mode == "silent":
                    time.sleep(0.02)
                if answers and self.swallow_answers:
                    self.swallow_answers -= 1
                    break
                sink.sendall(piece)
        for one in (source, sink):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


@dataclass
class History:
    """What callers were told, to be compared with what is there in the end."""

    told: dict[str, set[str]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def acknowledged(self, key: str, job_id: str) -> None:
        """A caller heard that its request `key` is the job `job_id`."""
        with self._lock:
            self.told.setdefault(key, set()).add(job_id)

    def jobs(self) -> set[str]:
        return {job_id for ids in self.told.values() for job_id in ids}

    def check(self, records: JobRecords, store: FileStore, events: Events) -> None:
        """No acknowledged job is missing, none is there twice, and each has one life."""
        doubled = {key: ids for key, ids in self.told.items() if len(ids) > 1}
        assert not doubled, f"one request made several jobs: {doubled}"
        for job_id in self.jobs():
            check_life(job_id, records, store, events)


def check_life(job_id: str, records: JobRecords, store: FileStore, events: Events) -> None:
    """The record is there, its states followed each other, its result is one and is whole."""
    record = records.get(job_id)
    assert record is not None, f"{job_id} is lost"
    told = events.read(job_id, count=5000)
    states = [event.data["state"] for event in told if event.type == "state"]
    for before, after in itertools.pairwise(states):
        assert after in _AFTER.get(before, ()), f"{job_id}: {states}"
    assert states[-1] == record.state
    assert [event.type for event in told].count("end") == (record.state in TERMINAL)
    if record.state is JobState.SUCCEEDED:
        assert record.outputs
        for artifact in record.outputs.values():
            path = store.artifact_path(artifact)
            assert path.stat().st_size == artifact.bytes
        assert {path.parent for path in map(store.artifact_path, record.outputs.values())} == {
            store.root / "jobs" / job_id / f"a{record.attempt}"
        }


@dataclass(frozen=True)
class Census:
    """What a service holds at one moment. keys: those that do not expire by themselves."""

    keys: frozenset[str]
    temporary: int
    files: int
    descriptors: dict[int, int]
    memory: dict[int, int]
    children: dict[int, int]

    @classmethod
    def of(cls, connection: redis.Redis, root: Path, pids: list[int]) -> Census:
        """pids: of the processes whose descriptors, bytes and children are counted."""
        files = [path for path in root.rglob("*") if path.is_file() and "logs" not in path.parts]
        temporary = [path for path in files if ".part" in path.name or "checkpoint" in path.name]
        return cls(
            keys=frozenset(key for key in connection.scan_iter() if connection.ttl(key) < 0),
            temporary=len(temporary),
            files=len(files),
            descriptors={pid: len(os.listdir(f"/proc/{pid}/fd")) for pid in pids},
            memory={pid: memory_of(pid) for pid in pids},
            children={pid: len(children_of(pid)) for pid in pids},
        )


def memory_of(pid: int) -> int:
    """Bytes that a process holds in memory."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def children_of(pid: int) -> list[int]:
    """Pids of a process's children, the dead among them."""
    with suppress(OSError):
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
        return [int(word) for word in text.split()]
    return []


@contextmanager
def in_background(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Runs `work` beside the block; its argument says when to end. Raises what it raised."""
    over, failed = threading.Event(), []

    def run() -> None:
        try:
            work(over)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(600.0)
    assert not thread.is_alive()
    if failed:
        raise failed[0]
