from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from udflow.cloud.formats import read_cloud
from udflow.cloud.point_cloud import PointCloud

Read = Callable[[bytes], PointCloud]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Reads bytes as a file whose name says nothing."""

    def read_bytes(content: bytes) -> PointCloud:
        path = tmp_path / "scan"
        path.write_bytes(content)
        return read_cloud(path)

    return read_bytes
