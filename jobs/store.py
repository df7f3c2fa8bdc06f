"""Scans and results as plain files. A name that is visible is whole: everything is written under a
temporary name in the same folder, synced, renamed, and the folder synced.

    incoming/                      uploads on their way
    scans/<id>/data, scan.json     the bytes as uploaded, and what inspection found
    scans/by-sha256/<digest>       the id of the scan with these bytes
    jobs/<id>/job.json             what was asked for
    jobs/<id>/attempt.json         the attempt that was begun last
    jobs/<id>/record.json          how it ended
    jobs/<id>/a<attempt>/<name>    results of one attempt; the job record says which one counts
    jobs/<id>/checkpoint-a<attempt>  what an unfinished attempt leaves to go on with
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from jobs.files import (
    TEMPORARY,
    create_exclusive,
    make_folder,
    measure,
    read_json,
    replacing,
    write_json,
)
from jobs.ids import is_id, new_id, require_id
from jobs.spec import Artifact, JobRecord, JobSpec
from udflow import faults

CHECKPOINT = "checkpoint-a"  # + attempt
_DIGEST_CHARACTERS = frozenset("0123456789abcdef")


@dataclass(frozen=True)
class AddedScan:
    """created: False when a scan with the same bytes was there already."""

    id: str
    created: bool


class Upload:
    """A file on its way in: write pieces, then hand it to `FileStore.add_scan`.

    Leaving the `with` block removes whatever was not added. size: bytes so far.
    """

    def __init__(self, path: Path, mode: Literal["xb", "r+b"] = "xb") -> None:
        self.path = path
        self.size = 0
        self._hash = hashlib.sha256()
        self._file = path.open(mode)

    @classmethod
    def of_file(cls, path: Path) -> Upload:
        """Bytes that are on disk already. Raises OSError."""
        upload = cls(path, mode="r+b")
        upload._hash = hashlib.file_digest(upload._file, "sha256")  # type: ignore[arg-type]
        upload.size = upload._file.tell()
        return upload

    def write(self, piece: bytes) -> None:
        """Append. Raises OSError (errno ENOSPC when the disk is full)."""
        self._file.write(piece)
        self._hash.update(piece)
        self.size += len(piece)

    def close(self) -> str:
        """Bring the bytes to disk. Their SHA-256, hexadecimal."""
        if not self._file.closed:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        return self._hash.hexdigest()

    def __enter__(self) -> Upload:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(OSError):  # what the full disk did not take is not wanted any more
            self._file.close()
        self.path.unlink(missing_ok=True)


class FileStore:
    """Scans and job results under one folder. Ids are checked before they become paths."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        for folder in ("incoming", "scans/by-sha256", "jobs"):
            (self.root / folder).mkdir(parents=True, exist_ok=True)

    # scans

    def receive(self) -> Upload:
        """Begin an upload."""
        return Upload(self.root / "incoming" / f"{TEMPORARY}{secrets.token_hex(8)}")

    def add_scan(self, upload: Upload, manifest: dict[str, Any]) -> AddedScan:
        """Turn an upload into a scan, or find the one that has the same bytes.

        manifest: JSON values, stored with `id`, `sha256`, `bytes` and `created_at` added. Scans of
        different `caller`s are different, whatever their bytes.
        """
        digest, caller = upload.close(), manifest.get("caller")
        known = self.find_scan(digest, caller)
        if known is not None:
            return AddedScan(known, created=False)
        scan_id = new_id("scan")
        folder = self._scan_folder(scan_id)
        make_folder(folder)
        os.replace(upload.path, folder / "data")
        faults.hit("scan.moved")
        about = {"id": scan_id, "sha256": digest, "bytes": upload.size, "created_at": time.time()}
        write_json(folder / "scan.json", manifest | about)
        faults.hit("scan.written")
        owner = self._claim_digest(digest, caller, scan_id)
        if owner != scan_id:  # the same bytes came in twice at once
            shutil.rmtree(folder, ignore_errors=True)
        return AddedScan(owner, created=owner == scan_id)

    def find_scan(self, digest: str, caller: str | None = None) -> str | None:
        """The id of the scan whose bytes have this SHA-256, among those of one caller."""
        if len(digest) != 64 or not _DIGEST_CHARACTERS.issuperset(digest):
            return None
        with suppress(FileNotFoundError):
            scan_id = self._digest_file(digest, caller).read_text()
            if self.read_scan(scan_id) is not None:
                return scan_id
        return None

    def scan_path(self, scan_id: str) -> Path:
        """The bytes as uploaded. The file is missing if there is no such scan."""
        return self._scan_folder(scan_id) / "data"

    def read_scan(self, scan_id: str) -> dict[str, Any] | None:
        """The manifest, None if there is no such scan.

        Raises:
            UnknownId: not the form of a scan id.
        """
        manifest: dict[str, Any] | None = read_json(self._scan_folder(scan_id) / "scan.json")
        return manifest

    def scans(self) -> Iterator[str]:
        """All scan ids, oldest first."""
        names = sorted(entry.name for entry in os.scandir(self.root / "scans"))
        return (name for name in names if is_id("scan", name))

    def delete_scan(self, scan_id: str) -> bool:
        """Remove a scan. False: there was none."""
        manifest = self.read_scan(scan_id)
        if manifest is None:
            return False
        folder = self._scan_folder(scan_id)
        (folder / "scan.json").unlink(missing_ok=True)  # first: a half-removed scan is no scan
        digest_file = self._digest_file(manifest["sha256"], manifest.get("caller"))
        with suppress(FileNotFoundError):
            if digest_file.read_text() == scan_id:
                digest_file.unlink()
        shutil.rmtree(folder, ignore_errors=True)
        return True

    def clear_half_scan(self, scan_id: str, before: float) -> None:
        """Remove bytes that never became a scan, if they came before Unix second `before`."""
        folder = self._scan_folder(scan_id)
        with suppress(FileNotFoundError):
            if folder.stat().st_mtime < before and not (folder / "scan.json").exists():
                shutil.rmtree(folder, ignore_errors=True)

    # jobs

    def write_job(self, spec: JobSpec) -> None:
        """Keep what was asked for, so that the queue can be rebuilt without Redis."""
        folder = self._job_folder(spec.id)
        make_folder(folder)
        write_json(folder / "job.json", spec.to_dict())

    def read_job(self, job_id: str) -> JobSpec | None:
        """What was asked for, None if there is no such job."""
        values = read_json(self._job_folder(job_id) / "job.json")
        return None if values is None else JobSpec.from_dict(values)

    def note_attempt(self, job_id: str, attempt: int) -> None:
        """Keep how far attempts have been counted, so that a Redis that forgets this job cannot
        give the same number to two workers."""
        write_json(self._job_folder(job_id) / "attempt.json", {"attempt": attempt})

    def last_attempt(self, job_id: str) -> int:
        """The attempt that was begun last, 0 if there was none."""
        values = read_json(self._job_folder(job_id) / "attempt.json")
        return 0 if values is None else int(values["attempt"])

    def write_record(self, record: JobRecord) -> bool:
        """Keep how a job ended, beside what it made. False: its files have been deleted."""
        folder = self._job_folder(record.id)
        if not (folder / "job.json").exists():
            return False
        write_json(folder / "record.json", record.to_dict())
        return True

    def read_record(self, job_id: str) -> dict[str, Any] | None:
        """How the job ended (`JobRecord.to_dict`), None if that is not known."""
        values: dict[str, Any] | None = read_json(self._job_folder(job_id) / "record.json")
        return values

    def jobs(self) -> Iterator[str]:
        """Ids of all jobs with files, oldest first."""
        names = sorted(entry.name for entry in os.scandir(self.root / "jobs"))
        return (name for name in names if is_id("job", name))

    def put_artifact(
        self, job_id: str, attempt: int, name: str, write: Callable[[Path], object]
    ) -> Artifact:
        """Let `write` fill a file, and make it visible whole under `name`.

        The path it gets ends with `name`, so that writers may choose the format by it.
        """
        folder = self._job_folder(job_id) / f"a{attempt}"
        make_folder(folder.parent)
        make_folder(folder)
        path = folder / name
        with replacing(path) as temporary:
            write(temporary)
            size, digest = measure(temporary)
        return Artifact(str(path.relative_to(self.root)), size, digest)

    def artifact_path(self, artifact: Artifact) -> Path:
        """Where an artifact of a job record lies.

        Raises:
            ValueError: the path leaves the store.
        """
        path = (self.root / artifact.path).resolve()
        if not path.is_relative_to(self.root / "jobs"):
            raise ValueError(f"artifact path {artifact.path!r} leads out of the store")
        return path

    def link_to(self, artifact: Artifact) -> str | None:
        """An address outside of the service to download it from, None if there is none."""
        return None

    def delete_attempt(self, job_id: str, attempt: int) -> None:
        """Remove what one attempt has written."""
        folder = self._job_folder(job_id)
        shutil.rmtree(folder / f"a{attempt}", ignore_errors=True)
        with suppress(OSError):  # not empty, as long as the job was not deleted
            folder.rmdir()

    def keep_only_attempt(self, job_id: str, attempt: int) -> None:
        """Remove what other attempts left behind."""
        for folder in self._job_folder(job_id).glob("a[0-9]*"):
            if folder.name != f"a{attempt}":
                shutil.rmtree(folder, ignore_errors=True)

    def checkpoint_path(self, job_id: str, attempt: int) -> Path:
        """Where an attempt keeps what the next one may go on with."""
        return self._job_folder(job_id) / f"{CHECKPOINT}{attempt}"

    def checkpoints(self, job_id: str, before: int) -> list[int]:
        """Earlier attempts that left a checkpoint, the newest first."""
        names = [path.name for path in self._job_folder(job_id).glob(f"{CHECKPOINT}*")]
        numbers = [name.removeprefix(CHECKPOINT) for name in names]
        found = [int(number) for number in numbers if number.isdigit()]
        return sorted((attempt for attempt in found if attempt < before), reverse=True)

    def share_checkpoint(self, job_id: str, attempt: int) -> None:
        """Let workers on other machines see what was written; a shared folder needs nothing."""

    def clear_checkpoints(self, job_id: str) -> None:
        """Remove all of them, and what a killed attempt was writing beside: the job has ended."""
        folder = self._job_folder(job_id)
        for pattern in (f"{CHECKPOINT}*", f"{TEMPORARY}*-attempt.json"):
            for path in folder.glob(pattern):
                path.unlink(missing_ok=True)

    def delete_job(self, job_id: str) -> bool:
        """Remove a job's files. False: there were none."""
        folder = self._job_folder(job_id)
        (folder / "job.json").unlink(missing_ok=True)  # first: it must not come back
        existed = folder.exists()
        shutil.rmtree(folder, ignore_errors=True)
        return existed

    def sweep_temporary(self, older_than_s: float) -> int:
        """Remove temporary files that nobody finished. How many there were."""
        limit = time.time() - older_than_s
        removed = 0
        for path in self.root.rglob(f"{TEMPORARY}*"):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < limit:
                    path.unlink()
                    removed += 1
        return removed

    def free_bytes(self) -> int:
        """Room left on the disk."""
        return shutil.disk_usage(self.root).free

    def _scan_folder(self, scan_id: str) -> Path:
        return self.root / "scans" / require_id("scan", scan_id)

    def _job_folder(self, job_id: str) -> Path:
        return self.root / "jobs" / require_id("job", job_id)

    def _digest_file(self, digest: str, caller: str | None) -> Path:
        own = (
            digest if caller is None else hashlib.sha256(f"{caller} {digest}".encode()).hexdigest()
        )
        return self.root / "scans" / "by-sha256" / own

    def _claim_digest(self, digest: str, caller: str | None, scan_id: str) -> str:
        """Name the scan for these bytes, unless another one is named already."""
        path = self._digest_file(digest, caller)
        while True:
            if create_exclusive(path, scan_id.encode()):
                return scan_id
            owner = self.find_scan(digest, caller)
            if owner is not None:
                return owner
            path.unlink(missing_ok=True)  # it named a scan that was removed
