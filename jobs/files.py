"""Files that are visible only whole: temporary name, sync, rename, sync of the folder."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from udflow import faults

TEMPORARY = ".part-"  # how names of unfinished files begin


def make_folder(path: Path) -> None:
    """A folder that is still there after a power cut. Its parent must exist."""
    path.mkdir(exist_ok=True)
    _sync(path.parent)


def write_json(path: Path, values: Any) -> None:
    """Store JSON values atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, allow_nan=False))


def read_json(path: Path) -> Any:
    """Stored JSON values, None if there is no such file."""
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return None


def create_exclusive(path: Path, content: bytes, mode: int = 0o644) -> bool:
    """Create a file whole, with its content; False if it exists already."""
    temporary = temporary_beside(path)
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.link(temporary, path)
    except FileExistsError:
        return False
    finally:
        temporary.unlink()
    _sync(path.parent)
    return True


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path to fill, which then takes the place of `path`; removed on any error."""
    temporary = temporary_beside(path)
    try:
        yield temporary
        _sync(temporary)
        faults.hit("file.written")
        os.replace(temporary, path)
        faults.hit("file.renamed")
    finally:
        temporary.unlink(missing_ok=True)
    _sync(path.parent)


def temporary_beside(path: Path) -> Path:
    """A fresh name in the same folder, which ends with the same name."""
    return path.with_name(f"{TEMPORARY}{secrets.token_hex(8)}-{path.name}")


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def measure(path: Path) -> tuple[int, str]:
    """Bytes and SHA-256."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return file.tell(), digest
