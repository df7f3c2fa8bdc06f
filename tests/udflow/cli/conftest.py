"""A sphere that has been reconstructed, and the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import CENTRE, QUICK, RADIUS, sphere_points

from udflow.cli import main


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scan of a sphere and everything `reconstruct` makes of it."""
    folder = tmp_path_factory.mktemp("made")
    np.save(folder / "scan.npy", sphere_points(2_000))
    outputs = {"-o": "mesh.ply", "--field": "f.safetensors", "--report": "r.json"}
    outputs |= {"--points": "points.ply"}
    named = [part for flag, name in outputs.items() for part in (flag, str(folder / name))]
    assert main(["reconstruct", str(folder / "scan.npy"), *named, *QUICK, "--quiet"]) == 0
    return folder


@pytest.fixture
def scan(made: Path) -> str:
    return str(made / "scan.npy")


@pytest.fixture(scope="session")
def truth(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("truth") / "truth.obj"
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    ball.apply_translation(CENTRE)
    ball.export(path)
    return str(path)
