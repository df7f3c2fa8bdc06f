"""What a job is: the values that travel between asker and worker."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

from jobs.ids import new_id

DEFAULT_TTL_S = 7 * 24 * 3600


class JobState(StrEnum):
    """queued -> running -> succeeded | failed, with canceling between a cancel request and its
    confirmation, and back to queued when a worker is lost. expired: never started in time."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


JobKind = Literal["reconstruct", "extract"]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
TERMINAL = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED})


@dataclass(frozen=True)
class JobError:
    """Why a job failed. code: stable, for programs; message: cause and remedy, for people."""

    code: str
    message: str


@dataclass(frozen=True)
class Artifact:
    """A finished file. path: relative to the store's root; sha256: hexadecimal."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class JobSpec:
    """What was asked for; never changes.

    config: values for `udflow.config.from_dict`; ttl_s: how long the job and its files are kept
    after the end; created_at: Unix seconds.
    kind: "extract" makes another mesh from the field of the job `source`, inside `box` (two
    corners in world coordinates) if there is one, instead of fitting.
    wanted: names of the files to make, all of them when empty; retried_from: the job that this
    one repeats; webhook: address to tell of its states; caller: name of the key that asked.
    """

    id: str
    scan_id: str
    config: dict[str, Any]
    created_at: float
    metadata: dict[str, str] = field(default_factory=dict)
    ttl_s: float = DEFAULT_TTL_S
    kind: JobKind = "reconstruct"
    source: str | None = None
    box: Box | None = None
    wanted: tuple[str, ...] = ()
    retried_from: str | None = None
    webhook: str | None = None
    caller: str | None = None

    @classmethod
    def new(
        cls,
        scan_id: str,
        config: dict[str, Any],
        metadata: dict[str, str] | None = None,
        ttl_s: float = DEFAULT_TTL_S,
        **more: Any,
    ) -> JobSpec:
        """A specification with a fresh id, created now. more: other fields by name."""
        now = time.time()
        return cls(new_id("job", now), scan_id, config, now, metadata or {}, ttl_s, **more)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> JobSpec:
        """The inverse of `to_dict`. What a later version has added is left out."""
        known = {field.name for field in dataclasses.fields(cls)}
        values = {name: value for name, value in values.items() if name in known}
        tuples = {"wanted": tuple(values.get("wanted", ())), "box": box_of(values.get("box"))}
        return cls(**values | tuples)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class JobRecord:
    """The truth about a job at one moment. Times are Unix seconds by the clock of Redis.

    attempt: counts the starts; it is also the fence that keeps a lost worker from writing.
    progress: 0..1 of this attempt; eta_s: seconds left, None until it can be told.
    points, round, rounds, loss: from the running fit (densified points so far, residual).
    outputs: finished files by name, for example "mesh.ply"; empty until the job has succeeded, or
    was canceled with what there was so far kept.
    owner: the process that runs it.
    expires_at: when the job and its files are removed; None until the end.
    keep_partial: whether the cancel that was asked for wants a mesh of what is fitted so far.
    kind, source, box, wanted, retried_from, webhook, caller: as in `JobSpec`.
    """

    id: str
    scan_id: str
    state: JobState
    config: dict[str, Any]
    metadata: dict[str, str]
    created_at: float
    attempt: int
    crashes: int = 0
    stage: str | None = None
    progress: float = 0.0
    eta_s: float | None = None
    device: str | None = None
    points: int | None = None
    round: int = 0
    rounds: int = 0
    loss: float | None = None
    error: JobError | None = None
    outputs: dict[str, Artifact] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    started_at: float | None = None
    finished_at: float | None = None
    expires_at: float | None = None
    cancel_requested: bool = False
    cancel_requested_at: float | None = None
    owner: str | None = None
    ttl_s: float = DEFAULT_TTL_S
    keep_partial: bool = False
    kind: JobKind = "reconstruct"
    source: str | None = None
    box: Box | None = None
    wanted: tuple[str, ...] = ()
    retried_from: str | None = None
    webhook: str | None = None
    caller: str | None = None

    @property
    def is_terminal(self) -> bool:
        """Whether the state can never change again."""
        return self.state in TERMINAL

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        lists = {"warnings": list(self.warnings), "wanted": list(self.wanted)}
        return dataclasses.asdict(self) | lists


def box_of(values: Any) -> Box | None:
    """Two corners from JSON values."""
    if values is None:
        return None
    low, high = (tuple(map(float, corner)) for corner in values)
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
