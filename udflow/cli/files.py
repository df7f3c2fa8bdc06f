"""Inputs and outputs: standard streams, nothing overwritten, nothing half written."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from udflow.cli.exits import OutputError, UsageError
from udflow.errors import InvalidCloud

STREAM = "-"
temporary_files: set[Path] = set()  # what a signal has to remove


@contextlib.contextmanager
def opened_input(name: str) -> Iterator[Path]:
    """The path of an input; standard input is copied to a temporary file first.

    Raises:
        InvalidCloud: the file cannot be read, or what reads it refuses it; named in the message.
    """
    try:
        if name != STREAM:
            yield Path(name)
            return
        handle, copy = tempfile.mkstemp(prefix="udflow-")
        with _temporary(copy) as path:
            with os.fdopen(handle, "wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
            yield path
    except InvalidCloud as error:
        raise type(error)(f"{_shown(name)}: {error}") from error
    except OSError as error:
        raise InvalidCloud(f"{_shown(name)}: {_reason(error)}") from error


def check_outputs(*names: str | None, force: bool) -> None:
    """Refuse outputs that cannot be written, before anything is computed.

    Raises:
        UsageError: a file exists and `force` is not set, its folder is missing, or two outputs
            share a name.
    """
    given = [name for name in names if name is not None]
    for name in given:
        if given.count(name) > 1:
            raise UsageError(f"{_shown(name)} is given for two outputs; choose different names")
        if name != STREAM:
            _check_file(Path(name), force)


def write_output(name: str, write: Callable[[BinaryIO], Any], *, force: bool) -> None:
    """Write all of a file or nothing of it; `-` is standard output.

    Raises:
        UsageError: the file exists and `force` is not set.
        OutputError: the disk refused.
    """
    if name == STREAM:
        with tempfile.TemporaryFile() as copy:
            write(copy)
            copy.seek(0)
            shutil.copyfileobj(copy, sys.stdout.buffer)
        sys.stdout.buffer.flush()
        return
    path = Path(os.path.realpath(name))  # through a link, not over it
    try:
        _write_file(path, write, force)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {_reason(error)}") from error


def write_json(name: str, values: Any, *, force: bool) -> None:
    """As `write_output`, for JSON values."""
    text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    write_output(name, lambda file: file.write(text.encode()), force=force)


def print_json(values: Any) -> None:
    """JSON on standard output."""
    sys.stdout.write(json.dumps(values, indent=2, allow_nan=False) + "\n")


def _check_file(path: Path, force: bool) -> None:
    if path.is_dir():
        raise UsageError(f"{path} is a folder; give the name of a file in it")
    if path.exists() and not path.is_file():
        raise UsageError(f"{path} is a device or pipe; use - for standard output")
    if path.exists() and not force:
        raise UsageError(f"{path} exists; choose another name or add --force")
    if not path.parent.is_dir():
        raise UsageError(f"the folder {path.parent} does not exist; create it first")


def _write_file(path: Path, write: Callable[[BinaryIO], Any], force: bool) -> None:
    handle, name = tempfile.mkstemp(prefix=f".{path.name[:100]}.", dir=path.parent)
    with _temporary(name) as temporary:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_umask())  # mkstemp makes files for the owner alone
        _check_file(path, force)  # it may have appeared while we computed
        temporary.replace(path)


@contextlib.contextmanager
def _temporary(name: str) -> Iterator[Path]:
    """A file that is gone afterwards, whatever happens."""
    path = Path(name)
    temporary_files.add(path)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
        temporary_files.discard(path)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _shown(name: str) -> str:
    return "standard stream" if name == STREAM else name


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
