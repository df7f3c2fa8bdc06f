"""Where trajectories start and end: queries around the samples, and their feet."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.sampled_surface import SampledSurface
from udflow.neural_config import TrainingConfig

BOX = 1.5  # half edge of the trained box: three times the cloud's largest extent
_NEIGHBOUR = 50
_FULL_DENSITY = 20_000  # samples from which on the spread grows with their number


@dataclass(frozen=True)
class Trajectories:
    """Ends of trajectories.

    Attributes:
        query: x_1, (m, 3), unit frame.
        foot: x_0, (m, 3).
        reach: root mean square distance of the queries near the surface from it.
        side: (m,) 1 or -1, the side of the surface that a query lies on; None where no matter.
    """

    query: Tensor
    foot: Tensor
    reach: float
    side: Tensor | None = None

    def __len__(self) -> int:
        return len(self.query)


def query_spread(samples: Tensor, factor: float) -> Tensor:
    """Standard deviation of the queries around each of (n, 3) samples, (n,).

    `factor` times the distance to the 50th neighbour, times sqrt(n / 20 000) for denser clouds:
    the sampling of CAP-UDF (Zhou et al. 2022), which the paper builds on and does not change.
    """
    distance = NeighbourTree(samples).nearest(samples, _NEIGHBOUR + 1).distance[:, -1]
    return distance * (factor * max(1.0, (len(samples) / _FULL_DENSITY) ** 0.5))


def draw_trajectories(
    samples: Tensor,
    surface: SampledSurface | None,
    config: TrainingConfig,
    generator: torch.Generator,
) -> Trajectories:
    """Queries with a normal distribution around the samples, each sample equally often, and a share
    from the whole box; their feet by `surface`, or the nearest samples where it is None.

    Args:
        samples: P^n, (n, 3), unit frame.
        surface: where trajectories end.
        config: number and spread of the queries.
        generator: source of randomness, on the CPU.
    """
    far = round(config.far * config.queries)
    near = config.queries - far
    spread = query_spread(samples, config.spread)
    chosen = torch.randperm(len(samples), generator=generator)
    chosen = chosen.repeat(-(-near // len(samples)))[:near].to(samples.device)
    noise = torch.randn(near, 3, generator=generator).to(samples.device)
    box = BOX * (2 * torch.rand(far, 3, generator=generator) - 1)
    query = torch.cat([samples[chosen] + spread[chosen, None] * noise, box.to(samples.device)])
    if surface is None:
        foot = samples[NeighbourTree(samples).nearest(query, 1).index[:, 0]]
    else:
        foot = surface.project(query)
    offset = (query - foot)[: max(near, 1)]
    return Trajectories(query, foot, float(offset.square().sum(dim=1).mean().sqrt()))
