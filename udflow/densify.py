"""Iterative densification, equation (9): fit, flow queries back to the surface, keep, repeat.

It works on anything that projects points (`ProjectiveField`).
"""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.config import DensifyConfig
from udflow.fields.interface import ProjectiveField

_SPREAD = 0.25  # of the distance to the tenth neighbour: how far queries start from the samples
_NEIGHBOURS = 10
_OVERSAMPLING = 4  # candidates for every point wanted
_FARTHEST = 0.75  # of the distance to the tenth neighbour: how far from the cloud feet may lie
_LOPSIDED = 0.5  # of the same: a foot this far from its neighbours' mean lies beyond a rim


def rounds_needed(points: int, config: DensifyConfig) -> int:
    """Rounds until `points` samples have become the target number."""
    missing = max(config.target_points - points, 0)
    return -(-missing // config.points_per_round)


def reflow(
    samples: Tensor,
    cloud: Tensor,
    field: ProjectiveField,
    config: DensifyConfig,
    generator: torch.Generator,
) -> Tensor:
    """One Reflow of equation (9): P^{n+1} = P^n and projected queries with f < epsilon.

    Queries are drawn around the samples, most where samples are sparse, and flow back along the
    field. Kept are feet that the field itself puts nearer than epsilon to its surface and that
    lie between points of the cloud: what continues beyond a rim is an invention of the field.

    Args:
        samples: P^n, (n, 3), unit frame.
        cloud: P^0, (m, 3), the measured points.
        field: the field fitted to P^n.
        config: numbers of points and epsilon.
        generator: source of randomness, on the CPU.

    Returns:
        P^{n+1}: the samples, then up to `points_per_round` new points.
    """
    wanted = min(config.points_per_round, config.target_points - len(samples))
    if wanted <= 0:
        return samples
    local = NeighbourTree(samples).nearest(samples, _NEIGHBOURS).distance[:, -1]
    chosen = torch.multinomial(
        local.double().cpu().square(), _OVERSAMPLING * wanted, True, generator=generator
    ).to(samples.device)
    noise = torch.randn(len(chosen), 3, generator=generator).to(samples.device)
    feet = field.project(samples[chosen] + _SPREAD * local[chosen, None] * noise)
    distance = (feet - field.project(feet)).norm(dim=1)
    kept = (distance < config.threshold) & _between(feet, cloud)
    return torch.cat([samples, feet[kept][:wanted]])


def _between(feet: Tensor, cloud: Tensor) -> Tensor:
    """(n,) bool, whether feet have points of the cloud near them and on all sides."""
    near = NeighbourTree(cloud).nearest(feet, _NEIGHBOURS)
    radius = near.distance[:, -1]
    lopsided = (cloud[near.index].mean(dim=1) - feet).norm(dim=1)
    return (near.distance[:, 0] < _FARTHEST * radius) & (lopsided < _LOPSIDED * radius)
