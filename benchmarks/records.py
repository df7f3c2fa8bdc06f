"""The file of a benchmark's rows: parts made in several sittings become one table."""

from __future__ import annotations

import fcntl
import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from methods import METHODS, Settings

Row = dict[str, Any]
Key = tuple[str, str, str]


def key(row: Row) -> Key:
    """What a row is the answer to; a newer row takes the place of an older one."""
    return row["shape"], row["condition"], row["method"]


@contextmanager
def alone(file: Path) -> Iterator[None]:
    """Nobody else who asks is between reading and writing this file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha256(str(file.resolve()).encode()).hexdigest()[:16]
    with Path(tempfile.gettempdir(), f"udflow-bench-{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def read(file: Path, settings: Settings) -> dict[Key, Row]:
    """The rows so far, none where there is no file.

    Raises:
        SystemExit: the file was made with other settings; figures of both are not comparable.
    """
    if not file.exists():
        return {}
    values = json.loads(file.read_text())
    if values["settings"] != _plain(settings):
        raise SystemExit(
            f"{file.name} was made with {values['settings']}, this run with {_plain(settings)}; "
            "use the same settings, or save under another --name"
        )
    return {key(row): row for row in values["rows"]}


def write(
    file: Path, settings: Settings, rows: Iterable[Row], shapes: list[str], conditions: list[str]
) -> list[Row]:
    """All rows in the order of shapes, conditions and methods, one a line; that order back."""

    def place(row: Row) -> tuple[int, int, int]:
        return (
            shapes.index(row["shape"]),
            conditions.index(row["condition"]),
            METHODS.index(row["method"]),
        )

    ordered = sorted(rows, key=place)
    lines = ",\n".join(json.dumps(row) for row in ordered)
    settings_text = json.dumps(_plain(settings))
    file.write_text(f'{{"settings": {settings_text},\n"rows": [\n{lines}\n]}}\n')
    return ordered


def _plain(settings: Settings) -> dict[str, Any]:
    return asdict(settings) | {"assignments": list(settings.assignments)}
