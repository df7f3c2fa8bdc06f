"""What the service takes and gives, as pydantic models: the source of the OpenAPI document."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter
from pydantic.json_schema import WithJsonSchema

from jobs.spec import JobState
from udflow.config import PRESET_NAMES, Config

MetadataKey = Annotated[str, StringConstraints(min_length=1, max_length=64)]
MetadataValue = Annotated[str, StringConstraints(max_length=512)]
# plainer than the prefixItems of a tuple, which generators of clients know badly
THREE_NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
Vector = Annotated[tuple[float, float, float], WithJsonSchema(THREE_NUMBERS)]
OutputName = Literal[
    "mesh.ply",
    "mesh.glb",
    "mesh.obj",
    "mesh.stl",
    "points.ply",
    "field.safetensors",
    "report.json",
]


def _inlined(schema: Any, definitions: dict[str, Any]) -> Any:
    """The schema with its local references replaced by what they name."""
    if isinstance(schema, list):
        return [_inlined(item, definitions) for item in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return _inlined(definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions)
    return {key: _inlined(value, definitions) for key, value in schema.items() if key != "$defs"}


def config_schema() -> dict[str, Any]:
    """JSON Schema of a job's `config`: every parameter of udflow.config, each optional."""
    schema = TypeAdapter(Config).json_schema()
    inlined: dict[str, Any] = _inlined(schema, schema.get("$defs", {}))
    return inlined


class Strict(BaseModel):
    """A request: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", strict=True)


class JobCreate(Strict):
    """A new job.

    `config` changes single parameters of the preset, e.g. `{"extract": {"resolution": 128}}`;
    `metadata` is yours and comes back unchanged.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "scan_id": "scan_019ab3f0c2d17c0e9b1f2a3c4d5e6f70",
                    "preset": "fast",
                    "config": {"extract": {"resolution": 128}},
                    "metadata": {"room": "hall 3"},
                }
            ]
        }
    )

    scan_id: str = Field(max_length=64)
    preset: str = Field(default="fast", description=f"one of: {', '.join(PRESET_NAMES)}")
    config: Annotated[dict[str, Any], WithJsonSchema(config_schema())] = Field(default_factory=dict)
    outputs: list[OutputName] = Field(
        default_factory=list, max_length=8, description="the files to make; empty: all"
    )
    metadata: dict[MetadataKey, MetadataValue] = Field(default_factory=dict, max_length=16)
    ttl_s: Annotated[float, Field(gt=0, le=1e9)] | None = Field(
        default=None, description="seconds to keep the job after its end"
    )
    webhook: str | None = Field(
        default=None, max_length=2048, description="https address to tell of the job's states"
    )


class Scan(BaseModel):
    """A stored scan. Lengths are in the units of the file.

    `dropped` counts points that were not finite; `shift` is set where coordinates are too large for
    single precision.
    """

    id: str
    sha256: str
    bytes: int
    filename: str
    created_at: datetime
    format: str
    points: int
    dropped: int
    unique_points: int
    low: Vector
    high: Vector
    extent: Vector
    spacing: float
    noise: float
    has_colors: bool
    has_normals: bool
    shift: Vector | None
    warnings: list[str]
    links: dict[str, str]


class SampleInfo(BaseModel):
    """A simulated scan. url: of its file."""

    name: str
    title: str
    about: str
    points: int
    url: str


class SampleList(BaseModel):
    """All simulated scans."""

    samples: list[SampleInfo]


class JobFailure(BaseModel):
    """Why a job failed."""

    code: str
    message: str


class Output(BaseModel):
    """One file that a job made."""

    bytes: int
    sha256: str
    url: str


class Job(BaseModel):
    """A job as it is now. Terminal states never change.

    `progress` runs from 0 to 1 over the whole attempt; `points`, `round`, `rounds` and `loss` come
    from the running fit: points of the densified cloud so far, and the mean squared residual.
    """

    id: str
    kind: Literal["reconstruct", "extract"]
    scan_id: str
    source: str | None = Field(description="the job whose field an extraction uses")
    retried_from: str | None
    state: JobState
    stage: str | None
    progress: float = Field(ge=0, le=1)
    eta_s: float | None
    queue_position: int | None = Field(description="1 is next; null unless queued")
    attempt: int
    device: str | None
    points: int | None
    round: int
    rounds: int
    loss: float | None
    error: JobFailure | None
    warnings: list[str]
    outputs: dict[str, Output]
    partial: bool = Field(description="canceled, with a mesh of what was fitted by then")
    config: dict[str, Any]
    metadata: dict[str, str]
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None
    links: dict[str, str]


class UploadState(BaseModel):
    """A resumable upload. `scan` is what it became, `error` why it became none."""

    id: str
    filename: str
    length: int
    offset: int
    expires_at: datetime
    scan: Scan | None
    error: JobFailure | None


class DeliveryState(BaseModel):
    """One try to call a webhook. `status` is that of the answer, `error` why there was none."""

    event: str
    time: datetime
    attempt: int
    status: int | None
    error: str | None
    next_at: datetime | None


class DeliveryList(BaseModel):
    """The last tries, newest first."""

    deliveries: list[DeliveryState]


class Ticket(BaseModel):
    """Stands for the caller's key once, in `?ticket=` of a websocket."""

    ticket: str
    expires_in_s: int


class CostRange(BaseModel):
    """Nine of ten jobs like it lie between `low` and `high`."""

    expected: float
    low: float
    high: float


class CostEstimate(BaseModel):
    """Seconds of work, without the wait in the queue, and bytes of memory. `jobs` finished jobs
    have taught it, 0 if it is only a reference machine's; `basis` says so in words."""

    seconds: CostRange
    memory_bytes: CostRange
    jobs: int
    basis: str


class JobEstimate(BaseModel):
    """The answer to `?validate_only=true`: the job would be taken, and what it would take."""

    valid: Literal[True] = True
    scan_id: str
    config: dict[str, Any]
    estimate: CostEstimate
    jobs_ahead: int


class JobPage(BaseModel):
    """Jobs, the newest first. Ask again with ?cursor=next_cursor until it is null."""

    jobs: list[Job]
    next_cursor: str | None


class Event(BaseModel):
    """One event of a job."""

    id: str
    type: str
    time: datetime
    data: dict[str, Any]


class EventPage(BaseModel):
    """Events after the asked id. Ask again with ?after=last_id; `end` says that no more come."""

    events: list[Event]
    last_id: str
    end: bool


class DistanceQuestion(Strict):
    """Points in the units and frame of the scan. Documentation: the reader is udf_input."""

    points: list[Vector] = Field(max_length=100_000)
    gradients: bool = False
    closest: bool = False


class DistanceAnswer(BaseModel):
    """Answers in the order of the points, in the units and frame of the scan."""

    count: int
    distance: list[float]
    valid: list[bool]
    gradient: list[Vector] | None = None
    closest: list[Vector] | None = None


class Health(BaseModel):
    """The process is alive."""

    status: str


class Check(BaseModel):
    """One condition of being ready."""

    name: str
    ok: bool
    detail: str


class Readiness(BaseModel):
    """Jobs are taken and run."""

    ready: bool
    checks: list[Check]


class Info(BaseModel):
    """What this service can do.

    `presets` holds the complete parameters of each; `devices` is where jobs have lately run, empty
    before the first.
    """

    version: str
    presets: dict[str, dict[str, Any]]
    input_formats: list[str]
    output_formats: list[str]
    limits: dict[str, int]
    workers: int
    devices: list[str]


class ProblemItem(BaseModel):
    """One wrong value."""

    pointer: str
    code: str
    message: str


class ProblemBody(BaseModel):
    """RFC 9457 problem details."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    instance: str
    code: str
    request_id: str
    errors: list[ProblemItem] = []
