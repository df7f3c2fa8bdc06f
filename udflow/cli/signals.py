"""Ctrl-C ends the process at once and leaves no half-written file."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from udflow.cli.files import temporary_files


def stop_at_once_on_signals() -> None:
    """For a process that is this command and nothing else.

    The usual KeyboardInterrupt would free arrays that the threads of a KD-tree query still use,
    and the process would crash in place of ending. A signal that the caller ignores, as `nohup`
    does, stays ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    for path in temporary_files:
        path.unlink(missing_ok=True)
    # past Python's buffers, which this may have interrupted; the bar has hidden the cursor
    cursor = b"\n\x1b[?25h" if sys.stderr.isatty() else b""
    os.write(2, cursor + b"udflow: error: interrupted; no output is half written\n")
    os._exit(128 + number)
