"""schemathesis against the running service: no generated request, right or wrong, breaks it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from chaos_kit import SOAK
from whole_service import running

HERE = Path(__file__).resolve().parent
EXAMPLES = 30 if SOAK else 2  # of each operation and phase, beside those of the coverage


@pytest.fixture
def own_url(tmp_path: Path) -> Iterator[str]:
    """A service of its own: generated requests delete what they find."""
    with running(tmp_path / "data") as address:
        yield address


def test_generated_requests_find_no_mistake(own_url: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "schemathesis.cli"]
    command += ["--config-file", str(HERE / "schemathesis.toml"), "run", f"{own_url}/openapi.json"]
    # All checks but one, which wants every body that fits the schema to be taken: bytes that are
    # no point cloud, and ids of nothing, fit it too.
    command += ["--checks", "all", "--exclude-checks", "positive_data_acceptance"]
    command += ["--phases", "examples,coverage,fuzzing,stateful"]
    command += ["--max-examples", str(EXAMPLES), "--seed", "1", "--max-failures", "20"]
    command += ["--max-response-time", "60"]  # times are measured where nothing else runs
    environment = os.environ | {"SCHEMATHESIS_HOOKS": str(HERE / "schemathesis_hooks.py")}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{done.stdout[-12_000:]}{done.stderr[-2_000:]}"
    assert "Stateful" in done.stdout
