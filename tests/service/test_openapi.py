"""The OpenAPI document: current, complete, and without dangling references."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx

from service.problems import PROBLEMS
from service.write_openapi import text

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_committed_document_is_current() -> None:
    assert (DOCS / "openapi.json").read_text() == text(), (
        "run: python -m service.write_openapi > docs/openapi.json"
    )


def test_the_service_serves_it(client: httpx.Client) -> None:
    assert client.get("/openapi.json").json() == json.loads(text())


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if "$ref" in value:
            yield value["$ref"]
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from references(item)


def test_every_operation_has_a_name_and_every_reference_a_target() -> None:
    document = json.loads(text())
    operations = [op for path in document["paths"].values() for op in path.values()]
    names = [operation["operationId"] for operation in operations]
    assert len(set(names)) == len(names) >= 15
    known = {f"#/components/schemas/{name}" for name in document["components"]["schemas"]}
    assert set(references(document)) <= known
    assert all(operation["summary"] and operation["description"] for operation in operations)


def test_every_problem_is_explained() -> None:
    page = (DOCS / "api.md").read_text()
    missing = [
        code for code, (status, _) in PROBLEMS.items() if f"| {status} | `{code}` |" not in page
    ]
    assert missing == []


def test_the_service_is_made_without_what_few_requests_need() -> None:
    """Compiled loops and torch take seconds to load: an API that was killed is back sooner."""
    code = (
        "import sys, service.app; heavy = {'torch', 'numba', 'scipy'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
