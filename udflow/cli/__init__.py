"""The command line. Commands import what they need when they run, so `--help` is instant."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Iterator, Sequence

from udflow.cli.exits import (
    BAD_INPUT,
    FAILED,
    INTERRUPTED,
    OK,
    REMOTE,
    USAGE,
    OutputError,
    RemoteError,
    UsageError,
)
from udflow.cli.parser import build_parser
from udflow.cli.signals import stop_at_once_on_signals
from udflow.errors import (
    BadField,
    InvalidCloud,
    InvalidConfig,
    InvalidQuery,
    UdflowError,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments after the program's name; None takes those of this process.

    Returns:
        The exit code, see `udflow.cli.exits`.
    """
    try:
        options = build_parser().parse_args(argv)
    except SystemExit as done:  # argparse has written its message or the help already
        return done.code if isinstance(done.code, int) else USAGE
    if argv is None:
        stop_at_once_on_signals()
    command = importlib.import_module(f"udflow.cli.{options.command}")
    try:
        with _words_only(options.traceback):
            command.run(options)
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else FAILED
    return OK


@contextlib.contextmanager
def _words_only(traceback: bool) -> Iterator[None]:
    """Turn errors into one sentence on stderr and an exit code."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        # the reader of our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        _leave("interrupted; no output is half written", INTERRUPTED)
    except (UsageError, InvalidConfig) as error:
        _leave(str(error), USAGE)
    except (InvalidCloud, InvalidQuery, BadField) as error:
        _leave(str(error), BAD_INPUT)
    except RemoteError as error:
        _leave(str(error), REMOTE)
    except (UdflowError, OutputError) as error:
        _leave(str(error), FAILED)
    except MemoryError:
        _leave("out of memory; lower --resolution or thin the scan out first", FAILED)
    except Exception as error:
        if traceback:
            raise
        what = str(error) or type(error).__name__
        _leave(f"{what} (unexpected; `udflow --traceback ...` shows where)", FAILED)


def _leave(message: str, code: int) -> None:
    sys.stderr.write(f"udflow: error: {message}\n")
    raise SystemExit(code)
