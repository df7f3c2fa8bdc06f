"""Iterative densification, equation (9): fit, flow queries back to the surface, keep, repeat.

It works on anything that projects points (`ProjectiveField`) or has a distance and a gradient
(`DistanceField`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.config import DensifyConfig
from udflow.fields.interface import DistanceField, ProjectiveField

_SPREAD = 0.25  # of the distance to the tenth neighbour: how far queries start from the samples
_NEIGHBOURS = 10
_PULLS = 3
_OVERSAMPLING = 4  # candidates for every point wanted
_FARTHEST = 0.75  # of the distance to the tenth neighbour: how far from the cloud feet may lie
_LOPSIDED = 0.5  # of the same: a foot this far from its neighbours' mean lies beyond a rim


def rounds_needed(points: int, config: DensifyConfig) -> int:
    """Rounds until `points` samples have become the target number."""
    missing = max(config.target_points - points, 0)
    return -(-missing // config.points_per_round)


@dataclass(frozen=True)
class Round:
    """One Reflow of equation (9), and what became of its candidates.

    Attributes:
        number: from 1; 0 is the cloud itself.
        samples: P^n, (n, 3): the points before, then the new ones; every earlier cloud is a prefix.
        added: new points.
        candidates: queries that were flowed back.
        near: of these, feet with f < epsilon.
        supported: of these, feet between measured points (all, where the guard is off).
    """

    number: int
    samples: Tensor
    added: int
    candidates: int = 0
    near: int = 0
    supported: int = 0

    def counts(self) -> dict[str, int]:
        """The counters, for reports."""
        return {
            "round": self.number,
            "points": len(self.samples),
            "added": self.added,
            "candidates": self.candidates,
            "near": self.near,
            "supported": self.supported,
        }


def densified(
    cloud: Tensor,
    fit: Callable[[Tensor], ProjectiveField | DistanceField],
    config: DensifyConfig,
    generator: torch.Generator,
) -> Iterator[Round]:
    """P^0 -> fit -> P^1 -> fit -> ... of equation (9), for any fit whatever.

    Args:
        cloud: P^0, (m, 3), unit frame.
        fit: from P^n to a field; anything that projects, or has a distance and a gradient.
        config: numbers of points, epsilon, guard.
        generator: source of randomness, on the CPU.

    Yields:
        Every round, the cloud itself first, until the target is reached or nothing is added.

    Raises:
        InvalidConfig: the target lies below the number of points that there are.
    """
    config.require_above(len(cloud))
    latest = Round(0, cloud, 0)
    yield latest
    while len(latest.samples) < config.target_points:
        field = fit(latest.samples)
        latest = reflow_round(latest, cloud, field, config, generator)
        if latest.added == 0:
            return
        yield latest


def reflow(
    samples: Tensor,
    cloud: Tensor,
    field: ProjectiveField | DistanceField,
    config: DensifyConfig,
    generator: torch.Generator,
) -> Tensor:
    """The points of `reflow_round`, without its counters."""
    return reflow_round(Round(0, samples, 0), cloud, field, config, generator).samples


def reflow_round(
    before: Round,
    cloud: Tensor,
    field: ProjectiveField | DistanceField,
    config: DensifyConfig,
    generator: torch.Generator,
) -> Round:
    """One Reflow of equation (9): P^{n+1} = P^n and projected queries with f < epsilon.

    Queries are drawn around the samples, most where samples are sparse, and flow back along the
    field. Kept are feet that the field itself puts nearer than epsilon to its surface and, unless
    the guard is off, that lie between points of the cloud: what continues beyond a rim is an
    invention of the field.

    Args:
        before: P^n.
        cloud: P^0, (m, 3), the measured points.
        field: the field fitted to P^n.
        config: numbers of points, epsilon, guard.
        generator: source of randomness, on the CPU.

    Returns:
        P^{n+1}: the samples, then up to `points_per_round` new points.
    """
    samples = before.samples
    wanted = min(config.points_per_round, config.target_points - len(samples))
    if wanted <= 0:
        return Round(before.number + 1, samples, 0)
    queries = _queries(samples, _OVERSAMPLING * wanted, generator)
    feet = projective(field).project(queries)
    near = _is_near(feet, field, config.threshold)
    kept = near & _between(feet, cloud) if config.guard == "support" else near
    grown = torch.cat([samples, feet[kept][:wanted]])
    return Round(
        before.number + 1,
        grown,
        len(grown) - len(samples),
        len(queries),
        int(near.sum()),
        int(kept.sum()),
    )


def projective(field: ProjectiveField | DistanceField) -> ProjectiveField:
    """The field as something that projects, along its gradient where it has no way of its own.

    Raises:
        TypeError: the object neither projects nor has a distance and a gradient.
    """
    if isinstance(field, ProjectiveField):
        return field
    if isinstance(field, DistanceField):
        return _Descent(field)
    raise TypeError(
        f"{type(field).__name__} is no field: it needs project(points), or distance(points) and "
        "gradient(points)"
    )


@dataclass(frozen=True)
class _Descent:
    """Points pulled along the unit gradient by the distance, again and again."""

    field: DistanceField

    def project(self, points: Tensor) -> Tensor:
        for _ in range(_PULLS):
            direction = torch.nn.functional.normalize(self.field.gradient(points), dim=1)
            points = points - self.field.distance(points)[:, None] * direction
        return points


def _queries(samples: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """(count, 3) points around the (n, 3) samples, most where these are sparse."""
    local = NeighbourTree(samples).nearest(samples, _NEIGHBOURS).distance[:, -1]
    chosen = torch.multinomial(local.double().cpu().square(), count, True, generator=generator)
    chosen = chosen.to(samples.device)
    noise = torch.randn(count, 3, generator=generator).to(samples.device)
    return samples[chosen] + _SPREAD * local[chosen, None] * noise


def _is_near(
    feet: Tensor, field: ProjectiveField | DistanceField, threshold: float | None
) -> Tensor:
    """(n,) bool, f(foot) < epsilon: by the distance of the field, or the way to the next foot."""
    if threshold is None:
        return torch.isfinite(feet).all(dim=1)
    if isinstance(field, ProjectiveField):
        return (feet - field.project(feet)).norm(dim=1) < threshold
    return field.distance(feet) < threshold


def _between(feet: Tensor, cloud: Tensor) -> Tensor:
    """(n,) bool, whether feet have points of the cloud near them and on all sides."""
    near = NeighbourTree(cloud).nearest(feet, _NEIGHBOURS)
    radius = near.distance[:, -1]
    lopsided = (cloud[near.index].mean(dim=1) - feet).norm(dim=1)
    return (near.distance[:, 0] < _FARTHEST * radius) & (lopsided < _LOPSIDED * radius)
