"""A field in the manner of CAP-UDF (Zhou et al., NeurIPS 2022), written from its description.

One network d(x) >= 0 without time; a point is pulled along the unit slope by the distance. It is
here to be compared with, and to show that densification takes other fields too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor
from torch.nn.functional import normalize

from udflow.cloud.neighbours import NeighbourTree
from udflow.fields.evaluation import NetworkEvaluator, feet_within
from udflow.fields.outputs import energy_slopes, output_value
from udflow.neural_config import NetworkConfig

_PULLS = 2  # the second one takes back what the first went too far


@dataclass(frozen=True)
class CapUdfField:
    """A distance network and the pull along its slope.

    Attributes:
        config: the architecture; without FiLM, as there is no time.
        parameters: all parameters in one flat tensor, in the order of `Network.shapes`.
        reach: distance from the surface within which it was trained, unit frame.
        half_edge: of the box in which it answers, unit frame.
    """

    config: NetworkConfig
    parameters: Tensor
    reach: float
    half_edge: float

    def distance(self, points: Tensor) -> Tensor:
        """d(x) of (n, 3) points, (n,), >= 0."""
        return output_value(self.config.output, self._network(points)[0])

    def gradient(self, points: Tensor) -> Tensor:
        """grad d / |grad d| at (n, 3) points, (n, 3)."""
        return self._distance_and_gradient(points)[1]

    def velocity(self, points: Tensor, t: float) -> Tensor:
        """d grad d of (n, 3) points, the same at every time t: what a trajectory field would call
        its velocity, (n, 3)."""
        value, slope = self._network(points)
        return energy_slopes(self.config.output, value)[0][:, None] * slope

    def refine(self, points: Tensor) -> Tensor:
        """(n, 3) points pulled once: x - d grad d / |grad d|."""
        distance, gradient = self._distance_and_gradient(points)
        return points - distance[:, None] * gradient

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points."""
        for _ in range(_PULLS):
            points = self.refine(points)
        return points

    @property
    def solved(self) -> bool:
        """It is not: it was trained, and is what it has learned."""
        return False

    def covers(self, points: Tensor) -> Tensor:
        """(n,) bool, whether points lie in the box."""
        return (points.abs() <= self.half_edge).all(dim=1)

    def answers(self, points: Tensor, sites: NeighbourTree) -> tuple[Tensor, Tensor]:
        """Feet of (n, 3) points, and (n,) bool, whether they are as near the sites as the trained
        queries were."""
        return feet_within(self.reach, points, sites, self.project)

    def _distance_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        value, slope = self._network(points)
        by_value = energy_slopes(self.config.output, value)[0]  # has the sign of dd/ds
        direction = normalize(slope, dim=1) * by_value.sign()[:, None]
        return output_value(self.config.output, value), direction

    @cached_property
    def _network(self) -> NetworkEvaluator:
        return NetworkEvaluator(self.config, self.parameters)
