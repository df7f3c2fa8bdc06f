"""Reverse integration: from the query back to the surface."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from udflow.flow.schedule import TimeSchedule

Velocity = Callable[[Tensor, float], Tensor]


def integrate_reverse(velocity: Velocity, query: Tensor, schedule: TimeSchedule) -> Tensor:
    """Explicit Euler steps backward in time, equation (4).

    x_{t_{k-1}} = x_{t_k} - dt_k v(x_{t_k}, t_k) for k = K..1.

    Args:
        velocity: v(x, t) for x (n, 3) and a number t in (0, 1].
        query: x_1, (n, 3).
        schedule: the times.

    Returns:
        x_0, (n, 3): the estimated feet on the surface.
    """
    x = query
    for k in range(schedule.steps, 0, -1):
        x = x - schedule.step(k) * velocity(x, schedule.time(k))
    return x


def integrate_forward(velocity: Velocity, foot: Tensor, schedule: TimeSchedule) -> Tensor:
    """The inverse direction: x_{t_k} = x_{t_{k-1}} + dt_k v(x_{t_{k-1}}, t_{k-1}), k = 1..K.

    v is asked for at t_{k-1}, so at t = 0 in the first step; fields trained by equation (3) are
    not defined there. It serves fields with exact flows.
    """
    x = foot
    for k in range(1, schedule.steps + 1):
        x = x + schedule.step(k) * velocity(x, schedule.time(k - 1))
    return x


def unsigned_distance(query: Tensor, foot: Tensor) -> Tensor:
    """Equation (5): f(q) = || x_1 - x_0 ||, (n,)."""
    return (query - foot).norm(dim=-1)
