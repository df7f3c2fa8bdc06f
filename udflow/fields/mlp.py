"""The paper's field: a network d(x, t) whose velocity is d grad d, section III-C."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor
from torch.nn.functional import normalize

from udflow.cloud.neighbours import NeighbourTree
from udflow.fields.evaluation import NetworkEvaluator, feet_within
from udflow.fields.outputs import energy_slopes, output_value
from udflow.flow.integrate import integrate_reverse, unsigned_distance
from udflow.flow.schedule import TimeSchedule
from udflow.neural_config import NetworkConfig


@dataclass(frozen=True)
class MLPField:
    """A conservative velocity field from a network, equation (8).

    Attributes:
        config: the architecture.
        schedule: the times t_1 < ... < t_K at which it was trained.
        parameters: all parameters in one flat tensor, in the order of `Network.shapes`.
        reach: distance from the surface within which it was trained at t_K, unit frame.
        half_edge: of the box in which it answers, unit frame.
    """

    config: NetworkConfig
    schedule: TimeSchedule
    parameters: Tensor
    reach: float
    half_edge: float

    def value(self, points: Tensor, t: float) -> Tensor:
        """d(x, t) of (n, 3) points, (n,), >= 0."""
        return output_value(self.config.output, self._network(points, t)[0])

    def velocity(self, points: Tensor, t: float) -> Tensor:
        """v(x, t) = d grad d of (n, 3) points, (n, 3)."""
        value, slope = self._network(points, t)
        return energy_slopes(self.config.output, value)[0][:, None] * slope

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points by reverse integration, equation (4)."""
        return integrate_reverse(self.velocity, points, self.schedule)

    def refine(self, points: Tensor) -> Tensor:
        """The last step of equation (4), from t_1 to 0, for (n, 3) points near the surface."""
        return points - self.schedule.step(1) * self.velocity(points, self.schedule.time(1))

    def distance(self, points: Tensor) -> Tensor:
        """f of equation (5) for (n, 3) points, (n,)."""
        return unsigned_distance(points, self.project(points))

    def gradient(self, points: Tensor) -> Tensor:
        """Unit vectors away from the surface at (n, 3) points, (n, 3); zero on it."""
        return normalize(points - self.project(points), dim=1)

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

    @cached_property
    def _network(self) -> NetworkEvaluator:
        return NetworkEvaluator(self.config, self.parameters)
