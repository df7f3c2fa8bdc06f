"""From a job to its finished files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jobs.soundness import Soundness
from jobs.spec import JobRecord, JobState
from jobs.store import FileStore
from service.names import stem
from service.problems import Problem

_sound = Soundness()


@dataclass(frozen=True)
class ResultFile:
    """A finished file and the name a user wants it under."""

    path: Path
    sha256: str
    filename: str


def result_file(record: JobRecord, name: str, store: FileStore) -> ResultFile:
    """The file `name` of a finished job.

    Raises:
        Problem: 404 or 409 when there is no such file, 500 when it is damaged.
    """
    _require_success(record)
    artifact = record.outputs.get(name)
    if artifact is None:
        where = f"; the job {record.source}, whose field it used, may" if record.source else ""
        raise Problem("artifact_not_found", f"This job made no {name}{where}.")
    path = store.artifact_path(artifact)
    if not path.is_file():
        raise Problem("artifact_not_found", f"{name} is no longer in the store.")
    if not _sound.is_sound(path, artifact):
        raise Problem(
            "artifact_damaged",
            f"{name} in the store is not what this job made: size or SHA-256 differ. Repeat the "
            f"job by POST /v1/jobs/{record.id}/retry, and look after the disk.",
        )
    scan = store.read_scan(record.scan_id) or {}
    return ResultFile(path, artifact.sha256, _filename(scan.get("filename", ""), name))


def _require_success(record: JobRecord) -> None:
    """Raises a 409 that says why there is no result (yet)."""
    if not record.is_terminal:
        raise Problem(
            "job_not_finished",
            f"The job is {record.state} ({record.progress:.0%}); follow "
            f"/v1/jobs/{record.id}/events, or ask again later.",
            headers={"Retry-After": "1"},
            state=record.state,
            progress=record.progress,
        )
    kept = record.state is JobState.CANCELED and bool(record.outputs)
    if record.state is not JobState.SUCCEEDED and not kept:
        error = vars(record.error) if record.error else None
        reason = record.error.message if record.error else "it was stopped before its end"
        detail = f"There is no result, the job is {record.state}: {reason}."
        raise Problem("job_failed", detail, state=record.state, error=error)


def _filename(scan_name: str, name: str) -> str:
    """`hall.pcd` gives `hall.ply` for the mesh and `hall-points.ply` for the points."""
    kind, _, suffix = name.partition(".")
    base = stem(scan_name)
    return f"{base}.{suffix}" if kind == "mesh" else f"{base}-{kind}.{suffix}"
