"""Distances in the units and frame of the scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.point_cloud import PointCloud
from udflow.config import from_dict
from udflow.errors import InvalidQuery
from udflow.fields.mlp import MLPField
from udflow.fields.network import Network, started
from udflow.fields.spline import SplineLevel
from udflow.fields.unsigned import FieldAnswer, SurfaceField, UnsignedDistanceField
from udflow.flow.schedule import TimeSchedule
from udflow.neural_config import NetworkConfig
from udflow.reconstruct import reconstruct

SMALL = from_dict({"extract": {"resolution": 64}})
RADIUS = 125.0
REACHED = 0.003 * 250  # largest error of this small fit


def directions(count: int) -> NDArray[np.float64]:
    normal = np.random.default_rng(1).normal(size=(count, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def queries(field: UnsignedDistanceField, count: int = 400) -> NDArray[np.float64]:
    """Points from 0.2 to 1.8 radii around the centre of the sphere, world frame."""
    radius = np.random.default_rng(2).uniform(0.2, 1.8, size=(count, 1)) * RADIUS
    return radius * directions(count) + np.asarray(field.normalisation.centre)


def test_distances_are_those_of_the_sphere_in_metres(sphere_field: UnsignedDistanceField) -> None:
    points = queries(sphere_field)
    offset = points - np.asarray(sphere_field.normalisation.centre)
    exact = np.abs(np.linalg.norm(offset, axis=1) - RADIUS)
    answer = sphere_field.query(points)
    assert answer.distance.dtype == np.float64
    np.testing.assert_allclose(answer.distance, exact, atol=REACHED)
    assert answer.valid.all()


def test_the_gradient_is_a_unit_vector_away_from_the_surface(
    sphere_field: UnsignedDistanceField,
) -> None:
    points = queries(sphere_field)
    offset = points - np.asarray(sphere_field.normalisation.centre)
    length = np.linalg.norm(offset, axis=1)
    away = offset / length[:, None] * np.sign(length - RADIUS)[:, None]
    answer = sphere_field.query(points)
    np.testing.assert_allclose(np.linalg.norm(answer.gradient, axis=1), 1, atol=1e-5)
    far = np.abs(length - RADIUS) > 0.1 * RADIUS
    assert (answer.gradient[far] * away[far]).sum(axis=1).min() > 0.99


def test_the_parts_of_an_answer_agree(sphere_field: UnsignedDistanceField) -> None:
    """closest = query - distance * gradient, and it lies on the surface."""
    points = queries(sphere_field)
    answer = sphere_field.query(points)
    rebuilt = points - answer.distance[:, None] * answer.gradient
    np.testing.assert_allclose(rebuilt, answer.closest, atol=1e-4)
    assert answer.closest.dtype == np.float64
    again = sphere_field.query(answer.closest)
    assert again.distance.max() < 0.001 * 250


def test_shift_and_scale_change_nothing_but_the_frame(
    sphere_field: UnsignedDistanceField,
) -> None:
    near = replace(sphere_field, normalisation=Normalisation((0.0, 0.0, 0.0), 1.0))
    points = queries(sphere_field)
    unit = (points - np.asarray(sphere_field.normalisation.centre)) / 250
    far_answer, near_answer = sphere_field.query(points), near.query(unit)
    np.testing.assert_allclose(far_answer.distance, 250 * near_answer.distance, atol=1e-3)


def test_the_trained_box_is_three_extents_wide(sphere_field: UnsignedDistanceField) -> None:
    centre = np.asarray(sphere_field.normalisation.centre)
    for corner, sign in ((sphere_field.low, -1), (sphere_field.high, 1)):
        assert (sign * (corner - centre) >= 1.5 * 250).all()
        assert (sign * (corner - centre) <= 2.5 * 250).all()
        inside = sphere_field.query((centre + 0.9999 * (corner - centre))[None])
        assert inside.valid.all()
        diagonal = 0.9999 * np.linalg.norm(corner - centre)
        assert inside.distance[0] == pytest.approx(diagonal - RADIUS, abs=0.05 * diagonal)


def test_outside_the_box_answers_say_so_and_stay_sensible(
    sphere_field: UnsignedDistanceField,
) -> None:
    centre = np.asarray(sphere_field.normalisation.centre)
    points = centre + 250 * np.array([[0.9, 0, 0], [4.0, 0, 0], [0, -50.0, 0], [0, 0, 1e6]])
    answer = sphere_field.query(points)
    assert answer.valid.tolist() == [True, False, False, False]
    exact = np.linalg.norm(points - centre, axis=1) - RADIUS
    np.testing.assert_allclose(answer.distance, exact, rtol=0.005)
    on_sphere = np.linalg.norm(answer.closest - centre, axis=1)
    np.testing.assert_allclose(on_sphere, RADIUS, rtol=0.005)


def test_beyond_a_rim_the_distance_is_that_of_the_rim() -> None:
    """A quadric at the rim would go on, and from far away the foot on it would be too near."""
    generator = np.random.default_rng(3)
    plate = np.append(generator.uniform(-1, 1, (4_000, 2)), np.zeros((4_000, 1)), axis=1)
    field = reconstruct(PointCloud(plate), SMALL).field
    away = np.array([[3.0, 0.2, 0.0], [-2.5, 0.0, 0.0], [0.1, 2.8, 0.0], [2.0, 0.0, 1.0]])
    exact = np.linalg.norm(away - np.clip(away, -1, 1) * [1, 1, 0], axis=1)
    spacing = 2 / np.sqrt(4_000)
    np.testing.assert_allclose(field.query(away).distance, exact, atol=0.6 * spacing)


def test_on_the_surface_the_gradient_is_zero(sphere_field: UnsignedDistanceField) -> None:
    """Where the energy is zero all around, a query is its own foot: 0, not 0 / 0."""
    finest = sphere_field.fitted.levels[0]
    still = SplineLevel.of(finest.grid, torch.zeros_like(finest.coefficients))
    spline = replace(sphere_field.fitted, levels=(still, *sphere_field.fitted.levels[1:]))
    near = UnsignedDistanceField(spline, sphere_field.surface, Normalisation((0.0, 0.0, 0.0), 1.0))
    points = (0.5 * directions(50)).astype(np.float32)
    answer = near.query(points)
    np.testing.assert_array_equal(answer.closest, points)
    assert not answer.distance.any()
    assert not answer.gradient.any()


def test_the_unit_field_is_the_same_field(sphere_field: UnsignedDistanceField) -> None:
    points = queries(sphere_field, 50)
    unit = torch.from_numpy(sphere_field.normalisation.to_unit(points))
    feet = sphere_field.normalisation.to_world(sphere_field.unit.project(unit).numpy())
    np.testing.assert_allclose(feet, sphere_field.query(points).closest, atol=1e-9)


def test_no_question_no_answer(sphere_field: UnsignedDistanceField) -> None:
    answer = sphere_field.query(np.empty((0, 3)))
    assert isinstance(answer, FieldAnswer)
    assert answer.distance.shape == answer.valid.shape == (0,)
    assert answer.gradient.shape == answer.closest.shape == (0, 3)


def test_answers_do_not_depend_on_the_company(sphere_field: UnsignedDistanceField) -> None:
    """Queries are answered in chunks; a single one gets the same answer as among many."""
    points = queries(sphere_field, 140_000)
    many = sphere_field.query(points)
    for i in (0, 70_000, 131_071, 131_072, 139_999):
        one = sphere_field.query(points[i : i + 1])
        assert one.distance[0] == pytest.approx(many.distance[i], abs=1e-3)


@pytest.mark.parametrize(
    "points",
    [np.zeros(3), np.zeros((4, 2)), np.zeros((2, 2, 3)), np.zeros((0, 4))],
    ids=lambda p: str(p.shape),
)
def test_a_wrong_shape_is_refused(
    sphere_field: UnsignedDistanceField, points: NDArray[np.float64]
) -> None:
    with pytest.raises(InvalidQuery) as caught:
        sphere_field.query(points)
    assert f"must be an (n, 3) array, not of shape {points.shape}" in str(caught.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_row_that_is_not_finite_is_named(
    sphere_field: UnsignedDistanceField, bad: float
) -> None:
    points = np.zeros((9, 3))
    points[4, 1] = points[7, 2] = bad
    with pytest.raises(InvalidQuery, match="row 4 has a coordinate that is not finite"):
        sphere_field.query(points)


def test_whole_numbers_and_single_precision_are_welcome(
    sphere_field: UnsignedDistanceField,
) -> None:
    whole = np.array([[512345, 5403210, 312]])
    expected = sphere_field.query(whole.astype(np.float64)).distance
    assert sphere_field.query(whole).distance == pytest.approx(expected)
    assert expected[0] == pytest.approx(RADIUS, abs=1.0)


def test_ends_are_those_of_the_quadrics_where_a_solved_field_comes_near_them(
    sphere_field: UnsignedDistanceField,
) -> None:
    unit = sphere_field.unit
    on_it = torch.from_numpy(0.5 * directions(300)).float()
    feet = unit.project(on_it)
    ends, sure = unit.ends(feet)
    assert float(sure.float().mean()) > 0.9
    assert torch.equal(ends, unit.surface.project(feet))
    off = [(p[sure].norm(dim=1) - 0.5).abs().mean() for p in (ends, feet)]
    assert off[0] < off[1]
    assert not bool(unit.ends(0.9 * on_it)[1].any())  # both differ: nothing is sure


def test_a_trained_field_ends_where_it_says(sphere_field: UnsignedDistanceField) -> None:
    config = NetworkConfig(layers=2, width=8, skips=(), film=(0,))
    parameters = started(Network(config), torch.Generator().manual_seed(0))
    trained = MLPField(config, TimeSchedule(5), parameters, 0.1, 1.5)
    points = torch.from_numpy(0.5 * directions(20)).float()
    ends, sure = SurfaceField(trained, sphere_field.surface).ends(points)
    assert torch.equal(ends, points)
    assert not bool(sure.any())
