"""Every setting of the environment is explained, and none that does not exist."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from jobs.settings import Settings

ROOT = Path(__file__).resolve().parents[1]
NAME = re.compile(r"\b(?:UDFLOW_[A-Z_]+[A-Z]|REDIS_URL|STORE_URL)\b")


def test_the_pages_and_the_code_know_the_same_settings() -> None:
    sources = [
        path for room in ("jobs", "service", "worker") for path in (ROOT / room).rglob("*.py")
    ]
    sources += (ROOT / "udflow").rglob("*.py")
    known = set(NAME.findall("".join(path.read_text() for path in sources)))
    durations = [field.name for field in dataclasses.fields(Settings) if field.name.endswith("_s")]
    known |= {f"UDFLOW_{name.upper()}" for name in durations}
    known -= {"UDFLOW_LISTEN_FD"}  # between the supervisor and the API alone
    known -= {"UDFLOW_FAULTS"}  # for tests alone; see docs/reliability.md
    pages = "".join((ROOT / "docs" / name).read_text() for name in ("api.md", "operations.md"))
    explained = set(NAME.findall(pages))
    assert known - explained == set()
    assert explained - known == set()
