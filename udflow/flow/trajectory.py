"""Straight trajectories between queries and the surface, and the loss on them."""

from __future__ import annotations

from torch import Tensor


def interpolate(query: Tensor, foot: Tensor, t: Tensor | float) -> Tensor:
    """State on the trajectory, equation (1): x_t = t x_1 + (1 - t) x_0.

    Args:
        query: x_1, (n, 3), where the trajectory is at t = 1.
        foot: x_0, (n, 3), the surface point where it is at t = 0.
        t: time in [0, 1], a number or (n, 1).

    Returns:
        (n, 3).
    """
    return t * query + (1 - t) * foot


def velocity_target(query: Tensor, foot: Tensor) -> Tensor:
    """The constant velocity of the trajectory, x_1 - x_0, (n, 3)."""
    return query - foot


def trajectory_loss(velocity: Tensor, query: Tensor, foot: Tensor) -> Tensor:
    """Equation (3): mean over the batch of || v(x_t, t) - (x_1 - x_0) ||^2.

    Args:
        velocity: v(x_t, t), (n, 3), evaluated at `interpolate(query, foot, t)`.
        query, foot: x_1 and x_0, (n, 3).

    Returns:
        A scalar, in lengths squared.
    """
    return (velocity - velocity_target(query, foot)).square().sum(dim=-1).mean()
