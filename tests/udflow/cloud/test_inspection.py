"""What is said about a scan, on scans of which everything is known."""

from __future__ import annotations

import dataclasses
import json
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from udflow.cloud.distinct import distinct, distinct_labels
from udflow.cloud.inspection import CloudSummary, inspect, require_reconstructable
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.shift import suggested_shift
from udflow.errors import InvalidCloud


def _grid(n: int = 60, step: float = 0.5) -> np.ndarray:
    """A flat sheet of n x n points."""
    line = np.arange(n) * step
    x, y = np.meshgrid(line, line)
    return np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)


def _said(summary: CloudSummary) -> str:
    return "; ".join(summary.warnings)


def test_counts_box_and_spacing_of_a_grid() -> None:
    grid = _grid()
    cloud = PointCloud(np.vstack([grid, grid[:900]]), format="ply", dropped=7, warnings=("said",))
    summary = inspect(cloud)
    assert (summary.points, summary.unique_points, summary.dropped) == (4500, 3600, 7)
    assert summary.low == (0.0, 0.0, 0.0)
    assert summary.high == summary.extent == (29.5, 29.5, 0.0)
    assert summary.spacing == 0.5
    assert summary.noise == 0.0
    assert summary.shift is None
    assert (summary.has_colors, summary.has_normals) == (False, False)
    assert summary.warnings[0] == "said"
    assert "20% of the points are exact duplicates" in _said(summary)
    assert "exactly flat" in _said(summary)
    assert json.loads(json.dumps(dataclasses.asdict(summary)))["extent"] == [29.5, 29.5, 0.0]


@pytest.mark.parametrize("sigma", [0.003, 0.03])
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_noise_is_the_spread_about_the_surface_in_units_of_the_scan(
    sigma: float, scale: float
) -> None:
    generator = np.random.default_rng(0)
    points = np.empty((20_000, 3))
    points[:, :2] = generator.uniform(0, 30, (20_000, 2))
    points[:, 2] = generator.normal(0, sigma, 20_000)
    summary = inspect(PointCloud(points * scale))
    assert summary.noise == pytest.approx(sigma * scale, rel=0.1)
    assert "flat" not in _said(summary)


def test_outliers_do_not_change_spacing_and_noise() -> None:
    generator = np.random.default_rng(0)
    points = _grid(100) + generator.normal(0, 0.01, (10_000, 3))
    clean = inspect(PointCloud(points))
    points[::50] += generator.uniform(-5, 5, (200, 3))
    dirty = inspect(PointCloud(points))
    assert dirty.spacing == pytest.approx(clean.spacing, rel=0.05)
    assert dirty.noise == pytest.approx(clean.noise, rel=0.15)


def test_uneven_density_is_said() -> None:
    even, sparse = _grid(50, 0.01), _grid(50, 1.0) + 10.0
    assert "uneven" in _said(inspect(PointCloud(np.vstack([even, sparse]))))
    assert "uneven" not in _said(inspect(PointCloud(even)))


@pytest.mark.parametrize(
    ("offset", "size", "expected"),
    [
        ((512345.0, 5403210.0, 300.0), 100.0, (512300.0, 5403200.0, 300.0)),
        ((-512345.0, 0.0, 0.0), 0.5, (-512345.0, 0.0, 0.0)),
        ((5.0, 0.0, 0.0), 0.004, (5.0, 0.0, 0.0)),
        ((15000.0, 12000.0, 0.0), 7000.0, None),
        ((99_000.0, 0.0, 0.0), 900.0, None),
        ((0.0, 0.0, 0.0), 1e6, None),
    ],
)
def test_a_shift_is_suggested_where_coordinates_are_large(
    offset: tuple[float, float, float], size: float, expected: tuple[float, float, float] | None
) -> None:
    half = np.array([size / 2, size / 3, size / 4])
    shift = suggested_shift(np.array(offset) - half, np.array(offset) + half)
    assert shift == expected


def test_large_coordinates_keep_their_statistics() -> None:
    generator = np.random.default_rng(0)
    points = _grid(80) + generator.normal(0, 0.01, (6400, 3))
    near, far = (
        inspect(PointCloud(points)),
        inspect(PointCloud(points + np.array([512000.0, 5403000.0, 300.0]))),
    )
    assert far.spacing == pytest.approx(near.spacing, rel=1e-5)
    assert far.noise == pytest.approx(near.noise, rel=1e-5)
    assert far.shift == (512000.0, 5403000.0, 300.0)
    assert "coordinates are large" in _said(far)


def test_the_smallest_clouds() -> None:
    lone = inspect(PointCloud(np.array([[1.0, 2.0, 3.0]])))
    assert (lone.points, lone.spacing, lone.noise) == (1, 0.0, 0.0)
    pair = inspect(PointCloud(np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 4.0]])))
    assert (pair.spacing, pair.noise) == (5.0, 0.0)


def test_three_hundred_thousand_points_take_about_a_second() -> None:
    points = np.random.default_rng(0).normal(size=(300_000, 3))
    started = time.process_time()
    inspect(PointCloud(points))
    assert time.process_time() - started < 3.0


SPREAD = np.random.default_rng(0).normal(size=(200, 3))


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.empty((0, 3)), "no points"),
        (SPREAD[:3], "3 distinct points; a surface needs at least 100"),
        (np.tile(SPREAD[:99], (50, 1)), "99 distinct points"),
        (np.tile(SPREAD[:1], (500, 1)), "all points are equal"),
        (SPREAD * 1e-40, "too small to compute with. Wrong byte order"),
        (np.vstack([SPREAD, [[1e35, 0, 0]]]), "largest coordinate is 1.0e[+]35. Wrong byte order"),
        (np.vstack([SPREAD, [[np.nan, 0, 0]]]), "largest coordinate is nan"),
        (np.vstack([SPREAD, [[0, np.inf, 0]]]), "largest coordinate is inf"),
    ],
)
def test_clouds_that_no_surface_can_be_made_of(points: np.ndarray, said: str) -> None:
    with pytest.raises(InvalidCloud, match=said):
        require_reconstructable(PointCloud(points))


@pytest.mark.parametrize("points", [SPREAD, SPREAD * 1e-20, SPREAD * 1e25, _grid(10)])
def test_odd_but_sound_clouds_are_accepted(points: np.ndarray) -> None:
    cloud = PointCloud(np.asarray(points))
    require_reconstructable(cloud)
    json.dumps(dataclasses.asdict(inspect(cloud)), allow_nan=False)


SMALL = st.sampled_from([0.0, -0.0, 1.0, 2.0, 3.0])


@given(arrays.arrays(np.float64, st.tuples(st.integers(1, 60), st.just(3)), elements=SMALL))
def test_distinct_points_by_definition(points: np.ndarray) -> None:
    seen: dict[tuple[float, ...], int] = {}
    for i, point in enumerate(points.tolist()):
        seen.setdefault(tuple(point), i)
    np.testing.assert_array_equal(distinct(points), list(seen.values()))
    found = distinct_labels(points)
    np.testing.assert_array_equal(found.first, list(seen.values()))
    np.testing.assert_array_equal(points[found.first][found.label], points)
