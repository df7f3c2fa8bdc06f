"""World frame to unit frame and back."""

from __future__ import annotations

import numpy as np
import pytest

from udflow.cloud.normalisation import Normalisation

UTM = np.array([512345.5, 5403210.25, 312.0])
SCAN = UTM + np.random.default_rng(0).uniform(-1, 1, (500, 3)) * [40.0, 15.0, 3.0]


def test_the_unit_frame_is_centred_and_its_largest_extent_is_one() -> None:
    unit = Normalisation.of(SCAN).to_unit(SCAN)
    extent = unit.max(axis=0) - unit.min(axis=0)
    assert extent.max() == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(unit.max(axis=0) + unit.min(axis=0), 0, atol=1e-6)
    assert unit.dtype == np.float32


def test_proportions_are_kept() -> None:
    normalisation = Normalisation.of(SCAN)
    assert normalisation.scale == pytest.approx(np.ptp(SCAN[:, 0]))
    unit = normalisation.to_unit(SCAN)
    length = np.linalg.norm(SCAN[1:] - SCAN[:-1], axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(unit[1:] - unit[:-1], axis=1), length / normalisation.scale, rtol=1e-4
    )


def test_map_coordinates_survive_single_precision() -> None:
    """In single precision a northing is good to half a metre; relative to the centre, to 5 um."""
    normalisation = Normalisation.of(SCAN)
    back = normalisation.to_world(normalisation.to_unit(SCAN))
    assert back.dtype == np.float64
    np.testing.assert_allclose(back, SCAN, rtol=0, atol=1e-5)
