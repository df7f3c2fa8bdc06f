"""Simulated scans: what they promise about themselves."""

from __future__ import annotations

import numpy as np
import pytest

from udflow.cloud.inspection import require_reconstructable
from udflow.cloud.samples import SAMPLES, sample
from udflow.errors import UnknownSample


@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_is_a_usable_scan(name: str) -> None:
    cloud = sample(name)
    require_reconstructable(cloud)
    assert len(np.unique(cloud.points, axis=0)) == SAMPLES[name].points
    assert 0.05 < np.ptp(cloud.points, axis=0).max() < 1.2  # metres


@pytest.mark.parametrize("name", SAMPLES)
def test_the_same_name_gives_the_same_points(name: str) -> None:
    assert np.array_equal(sample(name).points, sample(name).points)


def test_the_vase_has_colours_and_no_lid() -> None:
    cloud = sample("vase")
    assert cloud.colors is not None
    assert len(np.unique(cloud.colors, axis=0)) > 100
    height = cloud.points[:, 2].max()
    over_the_mouth = np.linalg.norm(cloud.points - [0.0, 0.0, height], axis=1)
    assert over_the_mouth.min() > 0.04


def test_no_point_of_the_shirt_lies_inside_the_seam_of_a_sleeve() -> None:
    points = sample("shirt").points
    across = points[np.abs(points[:, 0]) < 0.15]
    assert np.abs(across[across[:, 2] < 0.6][:, 1]).min() > 0.04  # front and back only


def test_the_gear_has_flat_faces() -> None:
    height = sample("gear").points[:, 2]
    faces = (np.abs(height) < 5e-4) | (np.abs(height - 0.016) < 5e-4)
    assert 0.4 < faces.mean() < 0.95


def test_the_shells_are_three() -> None:
    radius = np.linalg.norm(sample("shells").points, axis=1)
    counts, _ = np.histogram(radius, [0.0, 0.043, 0.045, 0.071, 0.073, 0.099, 0.101])
    assert counts[[1, 3, 5]].min() > 500
    assert counts[[0, 2, 4]].max() < 50


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownSample, match="vase, shirt, gear, shells"):
        sample("teapot")
