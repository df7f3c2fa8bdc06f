"""Losses of trained fields and their derivatives by the network's value and slope."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from udflow.fields.outputs import energy_slopes, output_value
from udflow.flow.trajectory import trajectory_loss, velocity_target
from udflow.neural_config import Output, PullLoss

# (s, grad s, x_1, x_0, t) -> loss, dL/ds, dL/d(grad s)
Objective = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
_TINY = 1e-12


def trajectory_objective(output: Output, value_weight: float = 0.0) -> Objective:
    """Equation (3) for v = d grad d: mean over the batch of ||v - (x_1 - x_0)||^2.

    The product d grad d is also small where d alone is small, which a fit may take for an answer.
    `value_weight` times (d - sqrt(t) |x_1 - x_0|)^2 asks for the d that the ideal field has; the
    paper's loss does without. The loss returned is that of equation (3) alone.
    """

    def objective(
        s: Tensor, slope: Tensor, query: Tensor, foot: Tensor, t: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        by_value, curvature = energy_slopes(output, s)
        velocity = by_value[:, None] * slope
        target = velocity_target(query, foot)
        residual = (velocity - target) * (2 / len(s))
        by_s = curvature * (residual * slope).sum(dim=1)
        if value_weight > 0:
            d, rate, _ = _folded(output, s)
            excess = d - t.sqrt() * target.norm(dim=1)
            by_s = by_s + (2 * value_weight / len(s)) * excess * rate
        return trajectory_loss(velocity, query, foot), by_s, by_value[:, None] * residual

    return objective


def by_side(s: Tensor, query: Tensor, foot: Tensor, t: Tensor, side: Tensor) -> Tensor:
    """Derivative by s of (s - side sqrt(t) |x_1 - x_0|)^2, (n,): s is drawn to the value that the
    ideal field has, positive on one side of the surface and negative on the other."""
    return 2 * (s - side * t.sqrt() * velocity_target(query, foot).norm(dim=1))


def pull_objective(output: Output, loss: PullLoss) -> Objective:
    """The loss of CAP-UDF (Zhou et al. 2022): a query pulled along the unit slope by its distance,
    q' = q - d grad d / |grad d|, has to arrive at the surface.

    loss "chamfer" is the published one: the L1 Chamfer distance between the set of moved queries
    and the set of their nearest samples, ignoring which belongs to which; "points" is the mean
    distance of the pairs.
    """

    def objective(
        s: Tensor, slope: Tensor, query: Tensor, foot: Tensor, t: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        distance, rate, sign = _folded(output, s)
        length = slope.norm(dim=1, keepdim=True).clamp_min(_TINY)
        direction = sign[:, None] * slope / length
        moved = query - distance[:, None] * direction
        value, by_moved = _LOSSES[loss](moved, foot)
        along = (by_moved * direction).sum(dim=1)
        across = by_moved - along[:, None] * direction
        by_slope = -(distance * sign)[:, None] * across / length
        return value, -along * rate, by_slope

    return objective


def _folded(output: Output, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """d, dd/ds and the sign of dd/ds (1 where it is zero), each (n,)."""
    d = output_value(output, s)
    if output == "abs":
        sign = torch.where(s < 0, -1.0, 1.0).to(s)
        return d, sign, sign
    by_value, _ = energy_slopes(output, s)
    return d, by_value / d.clamp_min(_TINY), torch.ones_like(d)


def _paired(moved: Tensor, foot: Tensor) -> tuple[Tensor, Tensor]:
    """Mean distance of pairs, and its gradient by the moved points."""
    offset = moved - foot
    length = offset.norm(dim=1, keepdim=True)
    return length.mean(), offset / length.clamp_min(_TINY) / len(moved)


def _chamfer(moved: Tensor, foot: Tensor) -> tuple[Tensor, Tensor]:
    """Half the sum of both mean nearest distances, and its gradient by the moved points."""
    distances = torch.cdist(moved, foot)
    there, back = distances.argmin(dim=1), distances.argmin(dim=0)
    value_there, gradient = _paired(moved, foot[there])
    value_back, by_found = _paired(moved[back], foot)
    gradient = gradient.index_add(0, back, by_found)
    return 0.5 * (value_there + value_back), 0.5 * gradient


_LOSSES = {"points": _paired, "chamfer": _chamfer}
