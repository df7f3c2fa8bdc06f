"""Iterative densification, equation (9): fit, flow queries back to the surface, keep, repeat.

It works on anything that projects points (`ProjectiveField`).
"""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.config import DensifyConfig
from udflow.fields.interface import ProjectiveField

_SPREAD = 0.5  # of the distance to the tenth neighbour: how far queries start from the samples
_NEIGHBOUR = 10
_OVERSAMPLING = 4  # candidates for every point wanted


def rounds_needed(points: int, config: DensifyConfig) -> int:
    """Rounds until `points` samples have become the target number."""
    missing = max(config.target_points - points, 0)
    return -(-missing // config.points_per_round)


def reflow(
    samples: Tensor,
    field: ProjectiveField,
    config: DensifyConfig,
    generator: torch.Generator,
) -> Tensor:
    """One Reflow of equation (9): P^{n+1} = P^n and projected queries with f < epsilon.

    Queries are drawn around the samples, most where samples are sparse, and flow back along the
    field. Of the feet that the field itself puts nearer than epsilon to its surface, those that
    lie farthest from the samples are taken, so that gaps fill first.

    Args:
        samples: P^n, (n, 3), unit frame.
        field: the field fitted to P^n.
        config: numbers of points and epsilon.
        generator: source of randomness, on the CPU.

    Returns:
        P^{n+1}: the samples, then up to `points_per_round` new points.
    """
    wanted = min(config.points_per_round, config.target_points - len(samples))
    if wanted <= 0:
        return samples
    tree = NeighbourTree(samples)
    local = tree.nearest(samples, _NEIGHBOUR).distance[:, -1]
    chosen = torch.multinomial(
        local.double().cpu().square(), _OVERSAMPLING * wanted, True, generator=generator
    ).to(samples.device)
    noise = torch.randn(len(chosen), 3, generator=generator).to(samples.device)
    queries = samples[chosen] + _SPREAD * local[chosen, None] * noise
    feet = field.project(queries)
    distance = (feet - field.project(feet)).norm(dim=1)
    gap = tree.nearest(feet, 1).distance[:, 0]
    # a foot far outside its neighbourhood continues the surface where there may be none
    kept = (distance < config.threshold) & (gap < local[chosen])
    feet, gap = feet[kept], gap[kept]
    return torch.cat([samples, feet[gap.argsort(descending=True)[:wanted]]])
