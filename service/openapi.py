"""What the OpenAPI document says beyond the signatures of the routes."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from service.requests import Cancel, Extraction, Redelivery, Slice
from service.schemas import DistanceAnswer, DistanceQuestion, JobCreate, ProblemBody

_BINARY = {"type": "string", "format": "binary"}
FILE_FORM: dict[str, Any] = {
    "multipart/form-data": {
        "schema": {
            "type": "object",
            "required": ["file"],
            "additionalProperties": False,
            "properties": {"file": _BINARY},
        }
    }
}
RAW_BODY: dict[str, Any] = {"application/octet-stream": {"schema": _BINARY}}

_DESCRIPTIONS = {
    400: "The request cannot be read",
    401: "A valid key is required",
    403: "The key lacks a right",
    404: "Unknown id",
    408: "The body stopped arriving",
    409: "Not possible in the job's state",
    410: "Deleted or expired",
    412: "Another version of tus",
    413: "The body is too large",
    415: "Unknown format",
    416: "The range lies outside the file",
    422: "Invalid values; `errors` points at each",
    423: "Another request is writing to the upload",
    429: "Too many jobs are waiting",
    503: "The queue does not answer, or the service is busy",
    507: "The disk is full",
}


Answers = dict[int | str, dict[str, Any]]


def problems(*statuses: int) -> Answers:
    """The problem answers of a route, for its `responses`."""
    schema = {"$ref": f"#/components/schemas/{ProblemBody.__name__}"}
    return {
        status: {
            "description": _DESCRIPTIONS[status],
            "content": {"application/problem+json": {"schema": schema}},
        }
        for status in statuses
    }


def job_request_body() -> dict[str, Any]:
    """The body of createJob: JSON about an uploaded scan, or a form that brings the file."""
    text = {"type": "string"}
    form = {
        "type": "object",
        "required": ["file"],
        "additionalProperties": False,
        "properties": {
            "file": _BINARY,
            "preset": text,
            "config": text | {"description": "JSON object"},
            "metadata": text | {"description": "JSON object"},
            "outputs": text | {"description": "JSON list"},
            "ttl_s": text,
            "webhook": text,
        },
    }
    return {
        "required": True,
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/JobCreate"}},
            "multipart/form-data": {"schema": form},
        },
    }


def model_body(name: str, *, required: bool = True) -> dict[str, Any]:
    """A JSON body of one of the named models."""
    schema = {"$ref": f"#/components/schemas/{name}"}
    return {"required": required, "content": {"application/json": {"schema": schema}}}


def udf_request_body() -> dict[str, Any]:
    """The body of queryDistances."""
    return {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": "#/components/schemas/DistanceQuestion"},
                "example": {"points": [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]], "gradients": True},
            },
            "application/x-npy": {"schema": _BINARY},
        }
        | RAW_BODY,
    }


def udf_answers() -> Answers:
    """The answers of queryDistances."""
    schema = {"$ref": "#/components/schemas/DistanceAnswer"}
    content = {
        "application/json": {"schema": schema},
        "application/x-npy": {"schema": _BINARY},
    }
    return {200: {"description": "Rows in the order of the points", "content": content | RAW_BODY}}


def document(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document, with the models that routes name by reference only."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
        )
        named: list[tuple[type[BaseModel], Literal["validation", "serialization"]]] = [
            (JobCreate, "validation"),
            (DistanceQuestion, "validation"),
            (Cancel, "validation"),
            (Redelivery, "validation"),
            (Extraction, "validation"),
            (Slice, "validation"),
            (DistanceAnswer, "serialization"),
            (ProblemBody, "serialization"),
        ]
        _, definitions = models_json_schema(named, ref_template="#/components/schemas/{model}")
        schema["components"]["schemas"] |= definitions["$defs"]
        _forget_other_errors(schema)
        _link(schema)
        schema["components"]["securitySchemes"] = {
            "key": {"type": "http", "scheme": "bearer", "description": "where a key is configured"}
        }
        schema["security"] = [{}, {"key": []}]
        app.openapi_schema = schema
    return app.openapi_schema


_OF_A_SCAN = {"getScan": "scan_id", "deleteScan": "scan_id"}
_OF_A_JOB = dict.fromkeys(
    (
        *("getJob", "cancelJob", "retryJob", "extractAgain", "deleteJob", "listJobEvents"),
        *("listDeliveries", "getMesh", "getPoints", "getField", "getReport"),
        *("queryDistances", "querySlice", "getSlice"),
    ),
    "job_id",
)
_LINKS = {
    ("/v1/scans", "201"): _OF_A_SCAN,
    ("/v1/jobs", "202"): _OF_A_JOB,
    ("/v1/jobs/{job_id}/retry", "202"): _OF_A_JOB,
}


def _link(schema: dict[str, Any]) -> None:
    """What can be done with the id of an answer, as links of OpenAPI."""
    for (path, status), targets in _LINKS.items():
        schema["paths"][path]["post"]["responses"][status]["links"] = {
            name: {"operationId": name, "parameters": {parameter: "$response.body#/id"}}
            for name, parameter in targets.items()
        }


def _forget_other_errors(schema: dict[str, Any]) -> None:
    """FastAPI announces its own form of validation errors, which never leaves this service."""
    for name in ("HTTPValidationError", "ValidationError"):
        schema["components"]["schemas"].pop(name, None)
    for path in schema["paths"].values():
        for operation in path.values():
            answer = operation["responses"].get("422", {})
            if "application/json" in answer.get("content", {}):
                operation["responses"]["422"] = problems(422)[422]
