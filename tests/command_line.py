"""The command line on a scan of a sphere, for the tests of its commands."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from shapes import Sphere

RADIUS, CENTRE = 5.0, np.array([100.0, -20.0, 3.0])
QUICK = ["--resolution", "32", "--set", "densify.target_points=0", "--set", "spline.resolution=24"]
UDFLOW = [sys.executable, "-m", "udflow"]


def sphere_points(count: int, seed: int = 0) -> np.ndarray:
    return Sphere(0.5).sample(count, seed).numpy().astype(float) * (2 * RADIUS) + CENTRE


def off_sphere(points: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.norm(points - CENTRE, axis=1) - RADIUS)


def run(*arguments: str, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*UDFLOW, *arguments], capture_output=True, check=False, **options)  # type: ignore[call-overload,no-any-return]
