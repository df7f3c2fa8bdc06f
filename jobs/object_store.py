"""Scans and results in a bucket, for parts that share no folder.

The bucket is the truth; its names are those of `jobs.store`. What a process reads or makes lies
beside it as a copy under its own data folder, and may be removed at any time.

obstore runs threads of its own, which a fork does not take along: what uses it must not fork
afterwards and use it again.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import obstore
from obstore.store import S3Store

from jobs.errors import BadSetting
from jobs.files import make_folder, replacing
from jobs.ids import is_id, new_id, require_id
from jobs.spec import Artifact, JobRecord, JobSpec
from jobs.store import CHECKPOINT, AddedScan, FileStore, Upload

log = logging.getLogger("store")

_LINK_LIFE = timedelta(minutes=15)
_MEDIA_TYPES = {
    "ply": "application/x-ply",
    "glb": "model/gltf-binary",
    "obj": "model/obj",
    "stl": "model/stl",
    "json": "application/json",
    "png": "image/png",
}


class ObjectStore(FileStore):
    """As `FileStore`, with the files in an S3 bucket.

    Args:
        url: s3://bucket/prefix. Credentials, region and endpoint come from the environment, by the
            names that AWS tools know (AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL, ...).
        root: folder of the copies, and of uploads on their way.

    Methods raise obstore.exceptions.BaseError when the bucket does not answer.
    """

    def __init__(self, url: str, root: Path) -> None:
        super().__init__(root)
        self._bucket: Any = _bucket(url)

    # scans

    def add_scan(self, upload: Upload, manifest: dict[str, Any]) -> AddedScan:
        """As `FileStore.add_scan`."""
        digest, caller = upload.close(), manifest.get("caller")
        known = self.find_scan(digest, caller)
        if known is not None:
            return AddedScan(known, created=False)
        scan_id = new_id("scan")
        about = {"id": scan_id, "sha256": digest, "bytes": upload.size, "created_at": time.time()}
        obstore.put(self._bucket, f"scans/{scan_id}/data", upload.path)
        self._put_json(f"scans/{scan_id}/scan.json", manifest | about)
        folder = self._scan_folder(scan_id)
        make_folder(folder)
        os.replace(upload.path, folder / "data")
        obstore.put(self._bucket, self._digest_name(digest, caller), scan_id.encode())
        return AddedScan(scan_id, created=True)

    def find_scan(self, digest: str, caller: str | None = None) -> str | None:
        """As `FileStore.find_scan`."""
        if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
            return None
        found = self._get(self._digest_name(digest, caller))
        scan_id = found.decode() if found is not None else ""
        return scan_id if scan_id and self.read_scan(scan_id) is not None else None

    def scan_path(self, scan_id: str) -> Path:
        """A copy of the bytes. The file is missing if there is no such scan."""
        path = super().scan_path(scan_id)
        self._fetch(f"scans/{scan_id}/data", path)
        return path

    def read_scan(self, scan_id: str) -> dict[str, Any] | None:
        """As `FileStore.read_scan`."""
        return self._get_json(f"scans/{require_id('scan', scan_id)}/scan.json")

    def scans(self) -> Iterator[str]:
        """As `FileStore.scans`."""
        return (name for name in self._folders("scans") if is_id("scan", name))

    def delete_scan(self, scan_id: str) -> bool:
        """As `FileStore.delete_scan`."""
        manifest = self.read_scan(scan_id)
        if manifest is None:
            return False
        digest = self._digest_name(manifest["sha256"], manifest.get("caller"))
        found = self._get(digest)
        if found is not None and found.decode() == scan_id:
            obstore.delete(self._bucket, digest)
        self._delete_all(f"scans/{scan_id}")
        super().delete_scan(scan_id)
        self._forget(self._scan_folder(scan_id))
        return True

    # jobs

    def write_job(self, spec: JobSpec) -> None:
        """As `FileStore.write_job`."""
        self._put_json(f"jobs/{spec.id}/job.json", spec.to_dict())

    def read_job(self, job_id: str) -> JobSpec | None:
        """As `FileStore.read_job`."""
        values = self._get_json(f"jobs/{require_id('job', job_id)}/job.json")
        return None if values is None else JobSpec.from_dict(values)

    def note_attempt(self, job_id: str, attempt: int) -> None:
        """As `FileStore.note_attempt`."""
        self._put_json(f"jobs/{job_id}/attempt.json", {"attempt": attempt})

    def last_attempt(self, job_id: str) -> int:
        """As `FileStore.last_attempt`."""
        values = self._get_json(f"jobs/{require_id('job', job_id)}/attempt.json")
        return 0 if values is None else int(values["attempt"])

    def write_record(self, record: JobRecord) -> bool:
        """As `FileStore.write_record`."""
        if self._get(f"jobs/{record.id}/job.json") is None:
            return False
        self._put_json(f"jobs/{record.id}/record.json", record.to_dict())
        return True

    def read_record(self, job_id: str) -> dict[str, Any] | None:
        """As `FileStore.read_record`."""
        return self._get_json(f"jobs/{require_id('job', job_id)}/record.json")

    def jobs(self) -> Iterator[str]:
        """As `FileStore.jobs`."""
        return (name for name in self._folders("jobs") if is_id("job", name))

    def put_artifact(
        self, job_id: str, attempt: int, name: str, write: Callable[[Path], object]
    ) -> Artifact:
        """As `FileStore.put_artifact`."""
        artifact = super().put_artifact(job_id, attempt, name, write)
        kind = _MEDIA_TYPES.get(name.rpartition(".")[2], "application/octet-stream")
        about = {"Content-Type": kind, "Content-Disposition": f'attachment; filename="{name}"'}
        path = super().artifact_path(artifact)
        obstore.put(self._bucket, artifact.path, path, attributes=about)
        return artifact

    def artifact_path(self, artifact: Artifact) -> Path:
        """A copy of the artifact; as `FileStore.artifact_path`."""
        path = super().artifact_path(artifact)
        self._fetch(artifact.path, path)
        return path

    def link_to(self, artifact: Artifact) -> str | None:
        """An address from which anybody can download the artifact for a quarter of an hour."""
        link: str = obstore.sign(self._bucket, "GET", artifact.path, _LINK_LIFE)
        return link

    def delete_attempt(self, job_id: str, attempt: int) -> None:
        """As `FileStore.delete_attempt`."""
        super().delete_attempt(job_id, attempt)
        self._delete_all(f"jobs/{require_id('job', job_id)}/a{attempt}")

    def keep_only_attempt(self, job_id: str, attempt: int) -> None:
        """As `FileStore.keep_only_attempt`."""
        super().keep_only_attempt(job_id, attempt)
        for name in self._folders(f"jobs/{require_id('job', job_id)}"):
            if name != f"a{attempt}":
                self._delete_all(f"jobs/{job_id}/{name}")

    def checkpoint_path(self, job_id: str, attempt: int) -> Path:
        """As `FileStore.checkpoint_path`, in a folder that is there."""
        path = super().checkpoint_path(job_id, attempt)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def checkpoints(self, job_id: str, before: int) -> list[int]:
        """As `FileStore.checkpoints`; brings those that are in the bucket."""
        folder = self._job_folder(job_id)
        for page in obstore.list(self._bucket, f"jobs/{job_id}"):
            for path in (Path(one["path"]) for one in page):
                if path.name.startswith(CHECKPOINT):
                    self._fetch(f"jobs/{job_id}/{path.name}", folder / path.name)
        return super().checkpoints(job_id, before)

    def share_checkpoint(self, job_id: str, attempt: int) -> None:
        """Puts it into the bucket; without the bucket the fit goes on."""
        path = self.checkpoint_path(job_id, attempt)
        try:
            obstore.put(self._bucket, f"jobs/{job_id}/{path.name}", path)
        except (obstore.exceptions.BaseError, OSError) as error:
            log.warning("the checkpoint of %s stays on this machine: %s", job_id, error)

    def clear_checkpoints(self, job_id: str) -> None:
        """As `FileStore.clear_checkpoints`."""
        super().clear_checkpoints(job_id)
        self._delete_all(f"jobs/{job_id}", CHECKPOINT)
        with suppress(OSError):  # copies of results are in it
            self._job_folder(job_id).rmdir()

    def delete_job(self, job_id: str) -> bool:
        """As `FileStore.delete_job`."""
        super().delete_job(job_id)
        with suppress(FileNotFoundError):
            obstore.delete(self._bucket, f"jobs/{job_id}/job.json")
        return self._delete_all(f"jobs/{job_id}")

    def sweep_temporary(self, older_than_s: float) -> int:
        """As `FileStore.sweep_temporary`; copies that were not read for so long go, too."""
        removed = super().sweep_temporary(older_than_s)
        limit = time.time() - older_than_s
        patterns = ("scans/*/data", "jobs/*/a*/*", f"jobs/*/{CHECKPOINT}*")
        for path in [path for pattern in patterns for path in self.root.glob(pattern)]:
            with suppress(FileNotFoundError):
                if path.stat().st_atime < limit:
                    path.unlink()
                    removed += 1
        return removed

    def _digest_name(self, digest: str, caller: str | None) -> str:
        return self._digest_file(digest, caller).relative_to(self.root).as_posix()

    def _get(self, name: str) -> bytes | None:
        try:
            return bytes(obstore.get(self._bucket, name).bytes())
        except FileNotFoundError:
            return None

    def _get_json(self, name: str) -> dict[str, Any] | None:
        found = self._get(name)
        values: dict[str, Any] | None = None if found is None else json.loads(found)
        return values

    def _put_json(self, name: str, values: Any) -> None:
        obstore.put(self._bucket, name, json.dumps(values, allow_nan=False).encode())

    def _fetch(self, name: str, path: Path) -> None:
        """Brings a copy, if there is none and the bucket has one."""
        if path.exists():
            return
        with suppress(FileNotFoundError):
            found = obstore.get(self._bucket, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary, temporary.open("wb") as file:
                for piece in found.stream():
                    file.write(piece)

    def _folders(self, name: str) -> list[str]:
        found = obstore.list_with_delimiter(self._bucket, name)
        return sorted(prefix.rstrip("/").rpartition("/")[2] for prefix in found["common_prefixes"])

    def _delete_all(self, name: str, beginning: str = "") -> bool:
        found = [one["path"] for page in obstore.list(self._bucket, name) for one in page]
        paths = [path for path in found if path.rpartition("/")[2].startswith(beginning)]
        if paths:
            obstore.delete(self._bucket, paths)
        return bool(paths)

    def _forget(self, folder: Path) -> None:
        (folder / "data").unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()


def shared_secret(url: str, fresh: str) -> bytes:
    """The signing key that all who use the bucket share. fresh: becomes it if there is none."""
    bucket: Any = _bucket(url)
    for _ in range(2):
        with suppress(FileNotFoundError):
            return bytes(obstore.get(bucket, "secret.key").bytes())
        with suppress(obstore.exceptions.AlreadyExistsError):
            obstore.put(bucket, "secret.key", fresh.encode(), mode="create")
    return bytes(obstore.get(bucket, "secret.key").bytes())


def _bucket(url: str) -> S3Store:
    endpoint = os.environ.get("AWS_ENDPOINT_URL", "")
    try:
        return S3Store.from_url(
            url,
            client_options={"allow_http": endpoint.startswith("http://"), "timeout": "60s"},
            virtual_hosted_style_request=not endpoint,
            retry_config={"max_retries": 3, "retry_timeout": timedelta(seconds=10)},
        )
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise BadSetting(f"STORE_URL cannot be used: {error}") from error
