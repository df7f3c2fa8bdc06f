"""Everything for real: supervisor, Redis, worker, reaper and API, started once for all tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from user_steps import Finished, sphere, submit, wait
from whole_service import running


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of the running service."""
    return tmp_path_factory.mktemp("up") / "data"


@pytest.fixture(scope="session")
def url(data_folder: Path) -> Iterator[str]:
    """The address of a running service."""
    with running(data_folder) as address:
        yield address


@pytest.fixture
def client(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=url, timeout=70) as http:
        yield http


@pytest.fixture(scope="session")
def finished(url: str) -> Finished:
    with httpx.Client(base_url=url, timeout=70) as client:
        points = sphere(1500)
        job_id = submit(client, points)
        job = wait(client, job_id)
    assert job["state"] == "succeeded", job
    return Finished(job_id, points, job)
