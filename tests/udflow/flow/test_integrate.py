"""Reverse integration on fields whose flows are known: equations (4) and (5)."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from shapes import PlanePatch, Shape, Sphere, Torus
from torch import Tensor

from udflow.flow.integrate import (
    Velocity,
    integrate_forward,
    integrate_reverse,
    unsigned_distance,
)
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate

WIND = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)


def points(count: int = 100) -> Tensor:
    generator = torch.Generator().manual_seed(2)
    return 1.6 * (torch.rand((count, 3), generator=generator, dtype=torch.float64) - 0.5)


def constant(x: Tensor, t: float) -> Tensor:
    return WIND.expand_as(x)


def growth(x: Tensor, t: float) -> Tensor:
    """dx/dt = x: x(1) = e x(0)."""
    return x


def rotation(x: Tensor, t: float) -> Tensor:
    """A quarter turn about z in unit time."""
    return 0.5 * math.pi * torch.stack([-x[:, 1], x[:, 0], torch.zeros_like(x[:, 2])], dim=1)


def ideal(shape: Shape) -> Velocity:
    """v*(x, t) = (x - NN(x)) / t, the field that equation (3) describes."""
    return lambda x, t: (x - shape.closest(x)) / t


class Diary:
    """A field that writes down where and when it was asked."""

    def __init__(self, velocity: Velocity) -> None:
        self.velocity = velocity
        self.states: list[Tensor] = []
        self.times: list[float] = []

    def __call__(self, x: Tensor, t: float) -> Tensor:
        self.states.append(x)
        self.times.append(t)
        return self.velocity(x, t)


@pytest.mark.parametrize("steps", [1, 2, 5, 30])
def test_a_constant_wind_carries_by_itself_whatever_the_steps(steps: int) -> None:
    x, schedule = points(), TimeSchedule(steps)
    torch.testing.assert_close(integrate_reverse(constant, x, schedule), x - WIND)
    torch.testing.assert_close(integrate_forward(constant, x, schedule), x + WIND)


def test_time_runs_from_the_query_down_to_the_surface() -> None:
    diary, schedule = Diary(constant), TimeSchedule(5)
    integrate_reverse(diary, points(1), schedule)
    assert tuple(diary.times) == tuple(reversed(schedule.times))
    back = Diary(constant)
    integrate_forward(back, points(1), schedule)
    assert tuple(back.times) == (0.0, *schedule.times[:-1])


QUARTER_BACK = torch.tensor([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=torch.float64)


@pytest.mark.parametrize(
    ("velocity", "exact"),
    [(growth, torch.eye(3).double() / math.e), (rotation, QUARTER_BACK)],
    ids=["growth", "rotation"],
)
def test_euler_converges_with_order_one(velocity: Velocity, exact: Tensor) -> None:
    x = points()
    errors = [
        float((integrate_reverse(velocity, x, TimeSchedule(k)) - x @ exact.T).norm())
        for k in (40, 80, 160, 320)
    ]
    orders = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert orders == pytest.approx([1.0, 1.0, 1.0], abs=0.1)
    assert errors[-1] < 0.01 * float(x.norm())


@pytest.mark.parametrize("velocity", [growth, rotation], ids=["growth", "rotation"])
def test_there_and_back_again(velocity: Velocity) -> None:
    x = points()
    misses = []
    for steps in (100, 200, 400):
        schedule = TimeSchedule(steps)
        there = integrate_forward(velocity, x, schedule)
        misses.append(float((integrate_reverse(velocity, there, schedule) - x).norm()))
    assert misses[-1] < 0.02 * float(x.norm())
    assert [math.log2(a / b) for a, b in pairwise(misses)] == pytest.approx([1.0, 1.0], abs=0.1)


@pytest.mark.parametrize("shape", [PlanePatch(half=5), Sphere(), Torus()], ids=type)
@pytest.mark.parametrize("steps", [1, 2, 3, 5, 12])
def test_the_ideal_field_lands_on_the_surface_in_any_number_of_steps(
    shape: Shape, steps: int
) -> None:
    query = points()
    foot = integrate_reverse(ideal(shape), query, TimeSchedule(steps))
    torch.testing.assert_close(foot, shape.closest(query), rtol=0, atol=1e-12)
    distance = unsigned_distance(query, foot)
    torch.testing.assert_close(distance, shape.distance(query), rtol=0, atol=1e-12)


def test_its_states_are_those_of_the_trajectory() -> None:
    """Every step multiplies the residual by (k - 1) / (k + 1) = t_{k-1} / t_k."""
    query, schedule = points(), TimeSchedule(5)
    diary = Diary(ideal(Sphere()))
    integrate_reverse(diary, query, schedule)
    foot = Sphere().closest(query)
    for state, t in zip(diary.states, diary.times, strict=True):
        torch.testing.assert_close(state, interpolate(query, foot, t))


def test_the_last_step_multiplies_an_error_of_the_field_by_its_length() -> None:
    query, schedule = points(), TimeSchedule(5)

    def wrong_near_the_surface(x: Tensor, t: float) -> Tensor:
        return ideal(Sphere())(x, t) + (WIND if t < 0.1 else 0.0)

    miss = Sphere().closest(query) - integrate_reverse(wrong_near_the_surface, query, schedule)
    torch.testing.assert_close(miss, (WIND / 15).expand_as(miss))


def test_distance_is_how_far_the_query_travelled() -> None:
    query = torch.tensor([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
    assert unsigned_distance(query, torch.zeros(2, 3)).tolist() == [0.0, 5.0]
