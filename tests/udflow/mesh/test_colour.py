"""Colours of samples on a mesh: nearest ones, mixed as light."""

from __future__ import annotations

import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.srgb import linear_to_srgb8, srgb8_to_linear
from udflow.mesh.colour import transfer_colors


def test_every_code_survives_the_way_to_light_and_back() -> None:
    codes = np.arange(256, dtype=np.uint8).repeat(3).reshape(-1, 3)
    np.testing.assert_array_equal(linear_to_srgb8(srgb8_to_linear(codes)), codes)
    assert srgb8_to_linear(np.array([[0, 128, 255]], np.uint8))[0] == pytest.approx(
        [0.0, 0.2158605, 1.0], abs=1e-6
    )


def test_a_vertex_on_a_sample_takes_its_color() -> None:
    generator = np.random.default_rng(0)
    points = generator.normal(size=(500, 3)) + np.array([512000.0, 5403000.0, 300.0])
    colors = generator.integers(0, 256, (500, 3)).astype(np.uint8)
    np.testing.assert_array_equal(transfer_colors(points, PointCloud(points, colors)), colors)


def test_half_way_between_black_and_white_is_half_the_light() -> None:
    cloud = PointCloud(
        np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([[0] * 3, [255] * 3], np.uint8)
    )
    middle = transfer_colors(np.array([[0.5, 0.0, 0.0]]), cloud)
    assert middle is not None
    assert middle.tolist() == [[188, 188, 188]]  # 0.5 of the light, not code 128


def test_weights_fall_with_the_square_of_the_distance() -> None:
    cloud = PointCloud(
        np.array([[0.0, 0, 0], [3.0, 0, 0]]), np.array([[0] * 3, [255] * 3], np.uint8)
    )
    near = transfer_colors(np.array([[1.0, 0.0, 0.0]]), cloud)
    assert near is not None
    assert near.tolist() == linear_to_srgb8(np.array([[0.2] * 3])).tolist()  # 1/4 to 1/1


def test_only_the_nearest_samples_count() -> None:
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [5, 5, 5]])
    colors = np.array([[10, 200, 30]] * 4 + [[255, 0, 255]], np.uint8)
    found = transfer_colors(np.array([[0.02, 0.02, 0.02]]), PointCloud(points, colors))
    assert found is not None
    assert found.tolist() == [[10, 200, 30]]


def test_clouds_without_colors_and_of_one_point() -> None:
    points = np.zeros((1, 3))
    assert transfer_colors(points, PointCloud(points)) is None
    lone = transfer_colors(points + 1.0, PointCloud(points, np.array([[1, 2, 3]], np.uint8)))
    assert lone is not None
    assert lone.tolist() == [[1, 2, 3]]
