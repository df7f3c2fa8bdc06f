"""`make up` as its user meets it: one start, one stop, nothing left."""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jobs.redis_server import EmbeddedRedis
from service.listening import CannotListen, listen


class Up:
    """One `python -m service.up` on its own data folder and port."""

    def __init__(self, data: Path, port: int, **environ: str) -> None:
        self.data = data
        inherited = {
            k: v
            for k, v in os.environ.items()
            if k not in ("REDIS_URL", "UDFLOW_HOST", "UDFLOW_KEY")
        }
        self.process = subprocess.Popen(
            [sys.executable, "-m", "service.up"],
            env=inherited
            | {"UDFLOW_DATA": str(data), "PORT": str(port), "OMP_NUM_THREADS": "1"}
            | environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines: list[str] = []

    def says(self, words: str) -> str:
        """The first further line that holds the words; fails when it ends without one."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line)
            if words in line:
                return line
        raise AssertionError("".join(self.lines))

    def ends(self, within_s: float = 12.0) -> int:
        """The exit code."""
        assert self.process.stdout is not None
        code = self.process.wait(within_s)
        self.lines += list(self.process.stdout)
        return code

    def processes(self) -> dict[int, str]:
        """Pid and command of everything that runs for this data folder."""
        found = running(self.data)
        found.pop(self.process.pid, None)
        return found

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        eventually(lambda: not self.processes())
        EmbeddedRedis(self.data).remove_socket()


def running(data: Path) -> dict[int, str]:
    """Pid and command of the processes that have the data folder in their environment, or its
    socket in their name (Redis writes its name over its environment)."""
    variable, name = f"UDFLOW_DATA={data}".encode(), str(socket_folder(data))
    found = {}
    for folder in Path("/proc").iterdir():
        try:
            command = (folder / "cmdline").read_text().replace("\0", " ")
            if name in command or variable in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = command
        except (OSError, ValueError):
            continue  # not a process, or it has just ended
    return found


def eventually(condition: Callable[[], object], within_s: float = 5.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def status(port: int, path: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30.0)
    connection.request("GET", path)
    code = connection.getresponse().status
    connection.close()
    return code


def socket_folder(data: Path) -> Path:
    return Path(EmbeddedRedis(data).url.removeprefix("unix://")).parent


@pytest.fixture
def start() -> Iterator[Callable[..., Up]]:
    """Starts supervisors, and ends them whatever happens."""
    started: list[Up] = []

    def begin(data: Path, port: int, **environ: str) -> Up:
        started.append(Up(data, port, **environ))
        return started[-1]

    yield begin
    for up in started:
        up.close()


def test_it_starts_heals_refuses_a_second_and_leaves_nothing(
    start: Callable[..., Up], tmp_path: Path
) -> None:
    port = free_port()
    up = start(tmp_path / "data", port)
    assert f"http://127.0.0.1:{port}" in up.says("ready at")
    assert "curl" in up.says("scan.ply")
    assert status(port, "/readyz") == 200
    parts = up.processes()
    assert sorted(command.split()[2] for command in parts.values() if "-m" in command) == [
        "service.serve",
        "worker",
        "worker.reaper",
    ]
    assert sum("redis.sock" in command for command in parts.values()) == 1

    second = start(up.data, free_port())  # same data folder
    assert second.ends() == 1
    assert f"running already with the data folder {up.data}" in second.lines[0]
    third = start(tmp_path / "other", port)  # same port
    assert third.ends() == 1
    assert f"for example PORT={port + 1} make up" in third.lines[0]
    assert running(third.data) == {}
    assert not socket_folder(third.data).exists()
    assert up.processes().keys() == parts.keys()

    api = next(pid for pid, command in parts.items() if "service.serve" in command)
    os.kill(api, signal.SIGKILL)
    assert status(port, "/healthz") == 200  # waits for the new one instead of being refused
    assert "again in" in up.says("api ended (signal 9)")

    began = time.monotonic()
    up.process.send_signal(signal.SIGINT)
    assert up.ends() == 0
    assert time.monotonic() - began < 10.0
    assert up.processes() == {}
    assert not socket_folder(up.data).exists()
    with listen("127.0.0.1", port):
        pass  # the port is free again
    assert not [line for line in up.lines if "ERROR" in line]


def test_nothing_survives_its_violent_death(start: Callable[..., Up], tmp_path: Path) -> None:
    up = start(tmp_path / "data", free_port())
    eventually(lambda: len(up.processes()) == 4, 20.0)
    up.process.kill()
    up.process.wait()
    eventually(lambda: not up.processes())

    again = start(up.data, free_port())  # what was left does not stand in the way
    again.says("ready at")
    again.process.terminate()
    assert again.ends() == 0
    assert not socket_folder(up.data).exists()


def test_a_redis_that_does_not_answer_is_said_at_once(
    start: Callable[..., Up], tmp_path: Path
) -> None:
    up = start(tmp_path, free_port(), REDIS_URL=f"redis://user:hush@127.0.0.1:{free_port()}")
    assert up.ends() == 1
    assert "no Redis answers at REDIS_URL" in up.lines[0]
    assert "hush" not in "".join(up.lines)


def test_an_open_address_needs_a_key(start: Callable[..., Up], tmp_path: Path) -> None:
    up = start(tmp_path, free_port(), UDFLOW_HOST="0.0.0.0")
    assert up.ends() == 1
    assert "UDFLOW_KEY" in up.lines[0]


def test_a_data_folder_that_cannot_be_is_said(start: Callable[..., Up], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    up = start(tmp_path / "file" / "data", free_port())
    assert up.ends() == 1
    assert "set UDFLOW_DATA to another" in up.lines[0]


def test_an_address_of_another_machine_is_said() -> None:
    with pytest.raises(CannotListen, match="cannot be used"):
        listen("192.0.2.1", 8000)
    with pytest.raises(CannotListen, match="is no address of this machine"):
        listen("no-such-host.invalid", 8000)
