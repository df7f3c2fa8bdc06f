"""A job record as the API shows it."""

from __future__ import annotations

from datetime import UTC, datetime

from jobs.records import JobRecords
from jobs.spec import Artifact, JobRecord, JobState
from service.schemas import Job, JobFailure, Output

# The address of each file of a finished job.
OUTPUT_PATHS = {
    "mesh.ply": "mesh?format=ply",
    "mesh.glb": "mesh?format=glb",
    "mesh.obj": "mesh?format=obj",
    "mesh.stl": "mesh?format=stl",
    "points.ply": "points",
    "field.safetensors": "field",
    "report.json": "report",
    "preview.png": "preview.png",
}


def current_view(record: JobRecord, records: JobRecords) -> Job:
    """The record as the API shows it; asks Redis for its place in the queue."""
    waits = record.state is JobState.QUEUED
    return job_view(record, records.queue_position(record.id) if waits else None)


def job_view(record: JobRecord, queue_position: int | None) -> Job:
    """The record with addresses, calendar times and its place in the queue."""
    return Job(
        id=record.id,
        kind=record.kind,
        scan_id=record.scan_id,
        source=record.source,
        retried_from=record.retried_from,
        state=record.state,
        stage=record.stage,
        progress=min(max(record.progress, 0.0), 1.0),
        eta_s=record.eta_s,
        queue_position=queue_position,
        attempt=record.attempt,
        device=record.device,
        points=record.points,
        round=record.round,
        rounds=record.rounds,
        loss=record.loss,
        error=JobFailure(**vars(record.error)) if record.error else None,
        warnings=list(record.warnings),
        outputs=_outputs(record.id, record.outputs),
        partial=record.state is JobState.CANCELED and bool(record.outputs),
        config=record.config,
        metadata=record.metadata,
        created_at=moment(record.created_at),
        started_at=_optional(record.started_at),
        finished_at=_optional(record.finished_at),
        expires_at=_optional(record.expires_at),
        links=_links(record),
    )


def moment(seconds: float) -> datetime:
    """Unix seconds as a UTC time."""
    return datetime.fromtimestamp(seconds, UTC)


def timestamp(seconds: float) -> str:
    """Unix seconds as RFC 3339 UTC text with milliseconds."""
    return moment(seconds).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _optional(seconds: float | None) -> datetime | None:
    return None if seconds is None else moment(seconds)


def _outputs(job_id: str, artifacts: dict[str, Artifact]) -> dict[str, Output]:
    return {
        name: Output(
            bytes=artifact.bytes,
            sha256=artifact.sha256,
            url=f"/v1/jobs/{job_id}/{OUTPUT_PATHS[name]}",
        )
        for name, artifact in artifacts.items()
        if name in OUTPUT_PATHS
    }


def _links(record: JobRecord) -> dict[str, str]:
    own = f"/v1/jobs/{record.id}"
    parts = ("events", "cancel", "retry", "mesh", "points", "field", "report", "udf")
    more = {"slice": f"{own}/udf/slice", "extract": f"{own}/extract"}
    return {
        "self": own,
        "scan": f"/v1/scans/{record.scan_id}",
        **{part: f"{own}/{part}" for part in parts},
        **more,
    }
