"""A job record as the fields of a Redis hash, and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from jobs.spec import Artifact, JobError, JobRecord, JobSpec, JobState, box_of


def initial_fields(spec: JobSpec, attempt: int = 1) -> dict[str, str]:
    """Of a job that waits for its attempt."""
    return texts(
        spec.to_dict()
        | {"state": JobState.QUEUED, "attempt": attempt, "crashes": 0, "progress": 0.0}
        | {"round": 0, "rounds": 0, "outputs": {}, "warnings": [], "cancel_requested": False}
        | {"keep_partial": False}
    )


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Values as Redis keeps them: numbers as written in Python, None empty, the rest as JSON."""
    return {name: _text(value) for name, value in values.items()}


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, str):
        return str(value)
    if isinstance(value, int | float):
        return repr(value)
    return json.dumps(value, default=asdict)


def flat(fields: Mapping[str, str]) -> list[str]:
    """Names and values in turn, as HSET takes them."""
    return [text for pair in fields.items() for text in pair]


def record_of(fields: Mapping[str, str]) -> JobRecord:
    """The record that a hash holds."""
    outputs = json.loads(fields.get("outputs") or "{}")
    error = fields.get("error")
    return JobRecord(
        id=fields["id"],
        scan_id=fields["scan_id"],
        state=JobState(fields["state"]),
        config=json.loads(fields["config"]),
        metadata=json.loads(fields["metadata"]),
        created_at=float(fields["created_at"]),
        ttl_s=float(fields["ttl_s"]),
        attempt=int(fields["attempt"]),
        crashes=int(fields["crashes"]),
        stage=fields.get("stage") or None,
        progress=float(fields["progress"]),
        eta_s=_float(fields, "eta_s"),
        device=fields.get("device") or None,
        points=int(fields["points"]) if fields.get("points") else None,
        round=int(fields["round"]),
        rounds=int(fields["rounds"]),
        loss=_float(fields, "loss"),
        error=JobError(**json.loads(error)) if error else None,
        outputs={name: Artifact(**value) for name, value in outputs.items()},
        warnings=tuple(json.loads(fields.get("warnings") or "[]")),
        started_at=_float(fields, "started_at"),
        finished_at=_float(fields, "finished_at"),
        expires_at=_float(fields, "expires_at"),
        cancel_requested=fields["cancel_requested"] == "1",
        cancel_requested_at=_float(fields, "cancel_requested_at"),
        owner=fields.get("owner") or None,
        keep_partial=fields.get("keep_partial") == "1",
        kind="extract" if fields.get("kind") == "extract" else "reconstruct",
        source=fields.get("source") or None,
        box=box_of(json.loads(fields.get("box") or "null")),
        wanted=tuple(json.loads(fields.get("wanted") or "[]")),
        retried_from=fields.get("retried_from") or None,
        webhook=fields.get("webhook") or None,
        caller=fields.get("caller") or None,
    )


def _float(fields: Mapping[str, str], name: str) -> float | None:
    text = fields.get(name)
    return float(text) if text else None
