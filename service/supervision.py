"""Child processes that are kept running, watched and stopped together."""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from logging.handlers import RotatingFileHandler
from pathlib import Path

from jobs.processes import tied_to_this_process

_SHORT_LIFE_S = 20.0  # dying sooner than this after the start is a failed start
_MOST_FAILED_STARTS = 5
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 15.0
_LOG_BYTES = 10 << 20
_LAST_LINES = 12


class GaveUp(Exception):
    """A part does not stay up."""


@dataclass(frozen=True)
class Part:
    """A program to keep running.

    fds: file descriptors that it inherits; parting: what it gets when this process is killed.
    """

    name: str
    command: tuple[str, ...]
    environ: Mapping[str, str]
    folder: Path
    fds: tuple[int, ...] = ()
    parting: signal.Signals = signal.SIGKILL


class Keeper:
    """Keeps one part running. Its lines go to a log file, those that `shown` picks to `say` too."""

    def __init__(
        self,
        part: Part,
        logs: Path,
        say: Callable[[str], None],
        shown: Callable[[str], bool],
    ) -> None:
        self.part = part
        self._say = say
        self._shown = shown
        self._log = RotatingFileHandler(
            logs / f"{part.name}.log", maxBytes=_LOG_BYTES, backupCount=1, encoding="utf-8"
        )
        self._last: deque[str] = deque(maxlen=_LAST_LINES)
        self._process: asyncio.subprocess.Process | None = None
        self._stopping = asyncio.Event()
        self._established = False

    async def keep(self) -> None:
        """Run the part again whenever it ends, until `stop`.

        Raises:
            GaveUp: it failed to start several times in a row, before `establish`.
            OSError: its program cannot be run.
        """
        failed_starts = 0
        while not self._stopping.is_set():
            began = time.monotonic()
            code = await self._run_once()
            if self._stopping.is_set():
                return
            short = time.monotonic() - began < _SHORT_LIFE_S
            failed_starts = failed_starts + 1 if short else 0
            if failed_starts >= _MOST_FAILED_STARTS and not self._established:
                raise GaveUp("\n".join([f"{self.part.name} does not stay up:", *self._last]))
            pause_s = min(_FIRST_PAUSE_S * 2**failed_starts, _LONGEST_PAUSE_S)
            self._say(f"{self.part.name} ended ({_described(code)}), again in {pause_s:g} s")
            with suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), pause_s)

    def establish(self) -> None:
        """It has worked once: from now on never give up, whatever it misses may come back."""
        self._established = True

    def ask_to_end(self) -> None:
        """SIGTERM, and no restart."""
        self._stopping.set()
        self._signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL, and no restart."""
        self._stopping.set()
        self._signal(signal.SIGKILL)

    async def ended(self, patience_s: float) -> None:
        """Wait for the process to end; kill it when patience is over."""
        if self._process is not None:
            try:
                await asyncio.wait_for(self._process.wait(), patience_s)
            except TimeoutError:
                self.kill()
                await self._process.wait()
        self._log.close()

    async def _run_once(self) -> int:
        self._process = await asyncio.create_subprocess_exec(
            *self.part.command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=dict(self.part.environ),
            cwd=self.part.folder,
            pass_fds=self.part.fds,
            start_new_session=True,  # Ctrl-C is for the supervisor, who stops all in order
            preexec_fn=tied_to_this_process(self.part.parting),
        )
        if self._stopping.is_set():  # asked while it was being started
            self._signal(signal.SIGTERM)
        if self._process.stdout is not None:
            await self._take_lines(self._process.stdout)
        return await self._process.wait()

    async def _take_lines(self, stream: asyncio.StreamReader) -> None:
        rest = b""
        while piece := await stream.read(1 << 16):
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                self._take(line.decode(errors="replace"))
        if rest:
            self._take(rest.decode(errors="replace"))

    def _take(self, line: str) -> None:
        self._last.append(line)
        self._log.emit(logging.makeLogRecord({"msg": "%s", "args": (line,)}))
        if self._shown(line):
            self._say(f"[{self.part.name}] {line}")

    def _signal(self, sig: signal.Signals) -> None:
        if self._process is not None and self._process.returncode is None:
            self._process.send_signal(sig)


def _described(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
