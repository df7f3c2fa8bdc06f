"""Smaller request bodies: what may be asked of a job that exists."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, FiniteFloat, model_validator
from pydantic.json_schema import WithJsonSchema

from service.schemas import THREE_NUMBERS, MetadataKey, MetadataValue, OutputName, Strict
from udflow.config import MAX_RESOLUTION

Number = Annotated[FiniteFloat, Field(strict=True)]
# not strict itself: JSON knows no tuples
Point = Annotated[tuple[Number, Number, Number], Field(strict=False), WithJsonSchema(THREE_NUMBERS)]
MAX_SLICE = 2048


class Cancel(Strict):
    """How to stop. keep_partial: make a mesh of what is fitted so far."""

    keep_partial: bool = False


class Redelivery(Strict):
    """Which event to send again; without it the last that happened."""

    event: (
        Literal["job.started", "job.succeeded", "job.failed", "job.canceled", "job.expired"] | None
    ) = None


class Box(Strict):
    """Two opposite corners in the units and frame of the scan."""

    low: Point
    high: Point

    @model_validator(mode="after")
    def _has_inside(self) -> Box:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError("box.low must lie below box.high on every axis")
        return self


class Extraction(Strict):
    """Another mesh from the stored field; what is not given is as in the job."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"resolution": 512, "box": {"low": [0, 0, 0], "high": [4, 3, 2.5]}}]
        },
    )

    resolution: Annotated[int, Field(ge=16, le=MAX_RESOLUTION)] | None = None
    extractor: Literal["edges", "cap"] | None = None
    box: Box | None = None
    outputs: list[OutputName] = Field(default_factory=list, max_length=8)
    metadata: dict[MetadataKey, MetadataValue] = Field(default_factory=dict, max_length=16)
    ttl_s: Annotated[float, Field(gt=0, le=1e9)] | None = None


class Slice(Strict):
    """A plane through the field, sampled at the centres of square cells.

    The plane is given by `axis` and the coordinate `at`, or by `origin`, `normal` and, if it
    matters what is up in the picture, `up`. Without any of them it is level and halves the scan.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"axis": "z", "at": 1.2, "resolution": 512, "format": "png"}]
        },
    )

    axis: Literal["x", "y", "z"] | None = None
    at: FiniteFloat | None = None
    origin: Point | None = None
    normal: Point | None = None
    up: Point | None = None
    width: Annotated[FiniteFloat, Field(gt=0)] | None = None
    height: Annotated[FiniteFloat, Field(gt=0)] | None = None
    resolution: Annotated[int, Field(ge=2, le=MAX_SLICE)] = 256
    format: Literal["npy", "png"] = "npy"
    isolines: bool = True

    @model_validator(mode="after")
    def _is_one_plane(self) -> Slice:
        if self.axis is not None and (self.normal is not None or self.origin is not None):
            raise ValueError("give axis and at, or origin and normal, not both")
        if self.at is not None and self.axis is None:
            raise ValueError("at needs an axis")
        if (self.width is None) != (self.height is None):
            raise ValueError("give width and height, or neither")
        return self
