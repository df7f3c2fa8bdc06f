"""`make up`: Redis, worker, reaper and API on one machine, started, kept running and stopped.

Each part dies with this process, whatever kills it. Parts write to <data>/logs; their errors are
shown here, and every line with UDFLOW_VERBOSE=1.
"""

from __future__ import annotations

import asyncio
import fcntl
import http.client
import json
import os
import re
import signal
import socket
import sys
import time
from collections.abc import Coroutine, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import redis

from jobs.redis_server import EmbeddedRedis
from jobs.settings import Settings
from service.listening import CannotListen, listen
from service.settings import ServiceSettings, SettingsError, from_environment
from service.supervision import GaveUp, Keeper, Part
from udflow.errors import UdflowError

_ROOT = Path(__file__).resolve().parent.parent
_REDIS_START_S = 15.0
_READY_S = 180.0  # the first import of torch on a slow disk takes its time
_PARTS_END_S = 6.0
_REDIS_END_S = 3.0
_ERROR_LINE = re.compile(r"\b(ERROR|CRITICAL)\b|^Traceback ")


class CannotStart(Exception):
    """Why, and what to do."""


def main() -> int:
    """Run until Ctrl-C or SIGTERM. The exit code."""
    try:
        return asyncio.run(_main(os.environ))
    except (CannotStart, CannotListen, GaveUp, SettingsError, UdflowError) as error:
        _say(f"cannot go on: {error}")
        return 1


async def _main(environ: Mapping[str, str]) -> int:
    front = from_environment(environ)
    settings = Settings.from_env(environ)
    data = settings.data.resolve()
    with ExitStack() as held:
        held.enter_context(_only_one(data, f"http://{_reachable(front.host)}:{front.port}"))
        server = held.enter_context(listen(front.host, front.port))
        (data / "logs").mkdir(exist_ok=True)
        return await Supervisor(front, settings, data, server, environ).run()


class Supervisor:
    """The parts of one data folder."""

    def __init__(
        self,
        front: ServiceSettings,
        settings: Settings,
        data: Path,
        server: socket.socket,
        environ: Mapping[str, str],
    ) -> None:
        self._front = front
        self._data = data
        self._server = server
        self._settings = settings
        self._given_url = settings.redis_url
        self._embedded = None if settings.redis_url else EmbeddedRedis(data)
        self._environ = dict(environ) | {"UDFLOW_DATA": str(data), "PYTHONUNBUFFERED": "1"}
        self._verbose = environ.get("UDFLOW_VERBOSE") == "1"
        self._parts: list[Keeper] = []
        self._redis: Keeper | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._asked = asyncio.Event()

    async def run(self) -> int:
        """Start all, wait for a signal, stop all. The exit code.

        Raises:
            CannotStart, GaveUp, NoRedisServer: with everything stopped again.
        """
        loop = asyncio.get_running_loop()
        for sig in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(sig, self._on_signal)
        try:
            await self._until_asked(self._start())
            if not self._asked.is_set():
                for keeper in self._parts:
                    keeper.establish()
                self._greet()
                await self._until_asked(asyncio.Event().wait())
            _say("stopping")
        finally:
            await self._stop()
        return 0

    def _on_signal(self) -> None:
        if self._asked.is_set():  # the second Ctrl-C: at once
            for keeper in self._parts:
                keeper.kill()
        self._asked.set()

    async def _until_asked(self, work: Coroutine[Any, Any, object]) -> None:
        """Until `work` is done or a signal came.

        Raises: what the work or the keeping of a part raises.
        """
        asked = asyncio.ensure_future(self._asked.wait())
        doing = asyncio.ensure_future(work)
        try:
            while not (asked.done() or doing.done()):
                await asyncio.wait({asked, doing, *self._tasks}, return_when="FIRST_COMPLETED")
                for task in self._tasks:
                    if task.done():
                        task.result()
            if doing.done():
                doing.result()
        finally:
            asked.cancel()
            doing.cancel()

    async def _start(self) -> None:
        if self._embedded is not None:
            self._environ["REDIS_URL"] = self._embedded.url
            command = tuple(self._embedded.command())
            self._redis = self._keep("redis", command, parting=signal.SIGTERM)
            await self._redis_answers(self._embedded)
        else:
            _check_given(self._given_url or "")
        python = (sys.executable, "-m")
        self._keep("worker", (*python, "worker"))
        self._keep("reaper", (*python, "worker.reaper"))
        if self._settings.webhook_secret is not None:
            self._keep("webhooks", (*python, "worker.webhooks"))
        self._environ["UDFLOW_LISTEN_FD"] = str(self._server.fileno())
        self._keep("api", (*python, "service.serve"), fds=(self._server.fileno(),))
        await self._ready()

    def _keep(
        self,
        name: str,
        command: tuple[str, ...],
        fds: tuple[int, ...] = (),
        parting: signal.Signals = signal.SIGKILL,
    ) -> Keeper:
        part = Part(name, command, dict(self._environ), _ROOT, fds, parting)
        keeper = Keeper(part, self._data / "logs", _say, self._is_shown)
        self._parts.append(keeper)
        self._tasks.append(asyncio.create_task(keeper.keep()))
        return keeper

    def _is_shown(self, line: str) -> bool:
        return self._verbose or _ERROR_LINE.search(line) is not None

    async def _redis_answers(self, embedded: EmbeddedRedis) -> None:
        deadline = time.monotonic() + _REDIS_START_S
        while not embedded.answers():
            if time.monotonic() > deadline:
                raise CannotStart(
                    f"Redis did not come up within {_REDIS_START_S:g} s; see {self._log('redis')}"
                )
            await asyncio.sleep(0.05)

    async def _ready(self) -> None:
        host, port = _reachable(self._front.host), self._front.port
        deadline = time.monotonic() + _READY_S
        reason = "no answer"
        while time.monotonic() < deadline:
            status, reason = await asyncio.to_thread(_ask, host, port)
            if status == 200:
                return
            await asyncio.sleep(0.2)
        raise CannotStart(f"not ready after {_READY_S:g} s ({reason}); see {self._data / 'logs'}")

    def _log(self, name: str) -> Path:
        return self._data / "logs" / f"{name}.log"

    def _greet(self) -> None:
        url = f"http://{_reachable(self._front.host)}:{self._front.port}"
        key = ' -H "Authorization: Bearer $UDFLOW_KEY"' if self._front.key else ""
        _say(f"ready at {url} (Ctrl-C stops it; data and logs in {self._data})")
        _say(f"reconstruct a scan: curl{key} -F file=@scan.ply {url}/v1/jobs")

    async def _stop(self) -> None:
        """All but Redis first: they still have something to write down."""
        others = [keeper for keeper in self._parts if keeper is not self._redis]
        for keeper in others:
            keeper.ask_to_end()
        await asyncio.gather(*(keeper.ended(_PARTS_END_S) for keeper in others))
        if self._redis is not None:
            self._redis.ask_to_end()
            await self._redis.ended(_REDIS_END_S)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._embedded is not None:
            self._embedded.remove_socket()


@contextmanager
def _only_one(data: Path, url: str) -> Iterator[None]:
    """Hold the data folder's lock.

    Raises:
        CannotStart: another one holds it, or the folder cannot be used.
    """
    try:
        data.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = (data / "lock").open("a+")
    except OSError as error:
        raise CannotStart(
            f"the data folder {data} cannot be used ({error.strerror}); set UDFLOW_DATA to another"
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise CannotStart(
                f"udflow is running already with the data folder {data} ({file.read().strip()}); "
                "stop it, or set UDFLOW_DATA to another folder and PORT to another port"
            ) from error
        file.truncate(0)
        file.write(f"{url}, process {os.getpid()}\n")
        file.flush()
        yield


def _check_given(url: str) -> None:
    """Raises CannotStart unless a Redis answers there."""
    client = redis.Redis.from_url(url, decode_responses=True, socket_connect_timeout=3, retry=None)
    try:
        persistence = client.info("persistence")
    except (redis.RedisError, ValueError) as error:
        raise CannotStart(
            f"no Redis answers at REDIS_URL ({_without_secret(str(error))}); start it, correct the "
            "URL, or unset it to use the embedded one"
        ) from error
    finally:
        client.close()
    if not persistence.get("aof_enabled"):
        _say("warning: this Redis keeps no append-only file, so jobs may be lost when it dies")


def _without_secret(text: str) -> str:
    return re.sub(r"//[^/@\s]*@", "//***@", text)


def _ask(host: str, port: int) -> tuple[int, str]:
    """Status and reason from /readyz; status 0 while nobody answers."""
    connection = http.client.HTTPConnection(host, port, timeout=5.0)
    try:
        connection.request("GET", "/readyz")
        answer = connection.getresponse()
        body = json.loads(answer.read(1 << 16) or b"{}")
        return answer.status, str(body.get("detail", body))
    except (OSError, http.client.HTTPException, ValueError) as error:
        return 0, str(error) or "no answer"
    finally:
        connection.close()


def _reachable(host: str) -> str:
    return {"0.0.0.0": "127.0.0.1", "::": "localhost"}.get(host, host)


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n" if line.startswith("[") else f"udflow: {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
