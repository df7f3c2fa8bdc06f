"""A network asked at many points: chunk by chunk, in memory that is used again."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.fields.network import Network
from udflow.fields.outputs import output_factor
from udflow.fields.passes import Pass, TimedNetwork
from udflow.neural_config import NetworkConfig

_CHUNK = 2048  # points evaluated together: what the network keeps of them stays in the cache


class NetworkEvaluator:
    """s(x, t) and its slope in x for any number of points.

    Args:
        config: the architecture.
        parameters: (size,) in the order of `Network.shapes`.

    Raises:
        BadField: the number of parameters is another.
    """

    def __init__(self, config: NetworkConfig, parameters: Tensor) -> None:
        self._network = Network(config)
        self._weights = self._network.views(parameters)
        self._parameters = parameters
        self._room = Pass(self._network, _CHUNK, parameters)

    def __call__(self, points: Tensor, t: float = 1.0) -> tuple[Tensor, Tensor]:
        """s (n,), before the output activation, and its gradient, (n, 3), of (n, 3) points."""
        times = self._parameters.new_full((1,), t)
        timed = TimedNetwork.at(self._network, self._weights, times)
        factor = output_factor(self._network.config.scale, times)
        value, slope = points.new_empty(len(points)), torch.empty_like(points)
        for start in range(0, len(points), _CHUNK):
            chunk = points[start : start + _CHUNK]
            whole = len(chunk) == _CHUNK
            room = self._room if whole else Pass(self._network, len(chunk), self._parameters)
            part = slice(start, start + len(chunk))
            value[part], slope[part] = room.run(timed, chunk)
        return value * factor, slope * factor


def feet_within(
    reach: float, points: Tensor, sites: NeighbourTree, project: Callable[[Tensor], Tensor]
) -> tuple[Tensor, Tensor]:
    """Feet (n, 3) of points no farther from the sites than a network was trained, and (n,) bool,
    which these are. What it says of its own distance is no evidence: far away it may say anything.

    Args:
        reach: distance of the farthest trained queries from the surface.
        points: (n, 3).
        sites: points that are known to be on the surface.
        project: to the feet, by the network.
    """
    near = sites.nearest(points, 1).distance[:, 0] <= reach
    feet = points.clone()
    feet[near] = project(points[near])
    return feet, near
