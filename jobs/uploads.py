"""Uploads that can be resumed: bytes that arrive over several requests, with restarts between.

uploads/<id>/data        what has come so far; its size is the offset
uploads/<id>/info.json   what was announced, and what became of it
"""

from __future__ import annotations

import fcntl
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from jobs.files import make_folder, read_json, write_json
from jobs.ids import is_id, new_id, require_id
from udflow import faults


@dataclass(frozen=True)
class UploadInfo:
    """What is known about an upload.

    length: bytes announced; metadata: as sent, base64 values by key; scan_id: of the scan that it
    became; error: the problem (code, detail) why it became none; caller: name of the key.
    """

    id: str
    length: int
    filename: str
    metadata: str
    created_at: float
    scan_id: str | None = None
    error: tuple[str, str] | None = None
    caller: str | None = None

    @property
    def is_settled(self) -> bool:
        """Whether it became a scan, or never will."""
        return self.scan_id is not None or self.error is not None


class UploadBusy(Exception):
    """Another request is writing to the upload."""


class UploadStore:
    """Uploads under `root`, which must exist. life_s: how long one waits for its next bytes."""

    def __init__(self, root: Path, life_s: float) -> None:
        self._folder = root / "uploads"
        self._folder.mkdir(exist_ok=True)
        self.life_s = life_s

    def create(self, length: int, filename: str, metadata: str, caller: str | None) -> UploadInfo:
        """A new upload of which no byte has come."""
        info = UploadInfo(new_id("upload"), length, filename, metadata, time.time(), caller=caller)
        folder = self._path(info.id)
        make_folder(folder)
        (folder / "data").touch()
        self.write(info)
        return info

    def read(self, upload_id: str) -> UploadInfo | None:
        """None if there is no such upload."""
        if not is_id("upload", upload_id):
            return None
        values: dict[str, Any] | None = read_json(self._path(upload_id) / "info.json")
        if values is None:
            return None
        error = values.get("error")
        return UploadInfo(**{**values, "error": tuple(error) if error else None})

    def write(self, info: UploadInfo) -> None:
        """Keep what has changed."""
        write_json(self._path(info.id) / "info.json", asdict(info))

    def offset(self, info: UploadInfo) -> int:
        """Bytes that have come; all of them once it is settled."""
        if info.is_settled:
            return info.length
        return self.data(info.id).stat().st_size

    def expires_at(self, info: UploadInfo) -> float:
        """When it is removed if nothing more comes, Unix seconds."""
        with suppress(FileNotFoundError):
            return self.data(info.id).stat().st_mtime + self.life_s
        return info.created_at + self.life_s

    def data(self, upload_id: str) -> Path:
        """Where its bytes are."""
        return self._path(upload_id) / "data"

    @contextmanager
    def writing(self, upload_id: str) -> Iterator[BinaryIO]:
        """The file to append to, for one writer at a time; on disk when the block is left.

        Raises:
            UploadBusy: somebody else has it.
            FileNotFoundError: it was removed.
        """
        with self.data(upload_id).open("r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UploadBusy from error
            file.seek(0, os.SEEK_END)
            try:
                yield file
            finally:
                file.flush()
                os.fsync(file.fileno())
                faults.hit("upload.appended")

    def delete(self, upload_id: str) -> None:
        """Remove it."""
        folder = self._path(upload_id)
        (folder / "info.json").unlink(missing_ok=True)  # first: half removed is removed
        shutil.rmtree(folder, ignore_errors=True)

    def expired(self) -> list[str]:
        """Ids of those whose time is over."""
        names = [entry.name for entry in os.scandir(self._folder) if is_id("upload", entry.name)]
        return [name for name in names if self._is_expired(name)]

    def _is_expired(self, upload_id: str) -> bool:
        info = self.read(upload_id)
        if info is None:  # a crash inside create or delete
            with suppress(FileNotFoundError):
                return time.time() > self._path(upload_id).stat().st_mtime + self.life_s
            return False
        return time.time() > self.expires_at(info)

    def _path(self, upload_id: str) -> Path:
        return self._folder / require_id("upload", upload_id)
