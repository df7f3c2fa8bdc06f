"""Trajectories and the loss on them: equations (1) to (3)."""

from __future__ import annotations

import pytest
import torch
from shapes import Shape, Sphere, Torus
from torch import Tensor

from udflow.flow.trajectory import interpolate, trajectory_loss, velocity_target


def pairs(count: int = 200, shape: Shape | None = None) -> tuple[Tensor, Tensor]:
    """Queries and their feet on a shape, double precision."""
    generator = torch.Generator().manual_seed(1)
    query = 1.6 * (torch.rand((count, 3), generator=generator, dtype=torch.float64) - 0.5)
    return query, (shape or Sphere()).closest(query)


def test_a_trajectory_starts_on_the_surface_and_ends_at_the_query() -> None:
    query, foot = pairs()
    assert torch.equal(interpolate(query, foot, 0.0), foot)
    assert torch.equal(interpolate(query, foot, 1.0), query)
    torch.testing.assert_close(interpolate(query, foot, 0.25), 0.25 * query + 0.75 * foot)


def test_each_trajectory_may_be_at_a_time_of_its_own() -> None:
    query, foot = pairs(3)
    states = interpolate(query, foot, torch.tensor([[0.0], [0.5], [1.0]], dtype=torch.float64))
    expected = torch.stack([foot[0], (query[1] + foot[1]) / 2, query[2]])
    torch.testing.assert_close(states, expected)


@pytest.mark.parametrize("t", [1 / 15, 0.4, 1.0])
def test_the_velocity_is_the_slope_of_the_trajectory(t: float) -> None:
    query, foot = pairs()
    slope = (interpolate(query, foot, t) - interpolate(query, foot, t - 0.01)) / 0.01
    torch.testing.assert_close(slope, velocity_target(query, foot))


@pytest.mark.parametrize("shape", [Sphere(), Torus()], ids=["sphere", "torus"])
@pytest.mark.parametrize("t", [1 / 15, 0.4, 1.0])
def test_the_ideal_field_in_closed_form_has_no_loss(shape: Shape, t: float) -> None:
    """NN(x_t) = NN(x_1) on the whole segment, so v*(x, t) = (x - NN(x)) / t."""
    query, foot = pairs(shape=shape)
    state = interpolate(query, foot, t)
    ideal = (state - shape.closest(state)) / t
    assert float(trajectory_loss(ideal, query, foot)) < 1e-26


def test_the_loss_is_the_mean_over_queries_of_the_squared_length() -> None:
    query, foot = pairs(4)
    error = torch.zeros(4, 3, dtype=torch.float64)
    error[0] = torch.tensor([0.3, 0.0, -0.4])
    error[3] = torch.tensor([0.0, 1.0, 0.0])
    loss = trajectory_loss(query - foot + error, query, foot)
    assert float(loss) == pytest.approx((0.25 + 1.0) / 4)
