"""Fitting a trained field: trajectories from the samples, a network, the loop."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config
from udflow.fields.cap_udf import CapUdfField
from udflow.fields.mlp import MLPField
from udflow.fields.network import Network, started
from udflow.fit.objectives import Objective, pull_objective, trajectory_objective
from udflow.fit.queries import BOX, Trajectories, draw_trajectories
from udflow.fit.sides import sides
from udflow.fit.training import Trainer, trainer_for
from udflow.flow.schedule import TimeSchedule
from udflow.neural_config import NetworkConfig

_REACH = 2.0  # root mean square distances of the queries: farther out they were too few
TrainedField = MLPField | CapUdfField


@dataclass(frozen=True)
class NeuralFit:
    """A fitted field.

    Attributes:
        field: the field.
        loss: of the last iterations; equation (3) for "mlp", the pull loss for "cap-udf".
    """

    field: TrainedField
    loss: float


def network_config(config: Config) -> NetworkConfig:
    """The architecture that a configuration asks for; CAP-UDF knows no time."""
    if config.field == "cap-udf":
        return replace(config.network, film=(), scale="learned")
    return config.network


def iterations_of(fit: int, rounds: int, config: Config) -> int:
    """Iterations of a fit, counted from 0: all of them for one fit; with rounds of densification
    half for the first fit and the other half shared equally by the rounds."""
    total = config.training.iterations
    if rounds == 0:
        return total
    first = -(-total // 2)
    return first if fit == 0 else max((total - first) // rounds, 1)


class NeuralFitting:
    """One fit under way.

    Args:
        samples: P^n, (n, 3), unit frame.
        surface: quadrics of the samples, where trajectories may end.
        config: network and training.
        iterations: to make.
        earlier: parameters of the fit before, to go on from; None starts anew.
        generator: source of the trajectories and their order, on the CPU.
        first: whether it is the fit to the measured points, which may be told sides.
    """

    def __init__(
        self,
        samples: Tensor,
        surface: SampledSurface,
        config: Config,
        iterations: int,
        earlier: Tensor | None,
        generator: torch.Generator,
        first: bool = True,
    ) -> None:
        self._config = config
        self._schedule = TimeSchedule(config.flow.steps)
        self._architecture = network_config(config)
        network = Network(self._architecture)
        if earlier is None:
            earlier = started(network, torch.Generator().manual_seed(config.seed))
        ends = surface if config.training.targets == "quadrics" else None
        trajectories = draw_trajectories(samples, ends, config.training, generator)
        if first and self._sided():
            side = sides(surface.surface, trajectories.query, trajectories.foot)
            trajectories = replace(trajectories, side=side)
        self._reach = _REACH * trajectories.reach
        self.total = iterations
        self.trainer = self._trainer(network, earlier.clone(), trajectories, iterations, generator)
        self.loss = float("inf")

    def _trainer(
        self,
        network: Network,
        parameters: Tensor,
        trajectories: Trajectories,
        iterations: int,
        generator: torch.Generator,
    ) -> Trainer:
        device = trajectories.query.device
        timed = self._config.field == "mlp"
        return trainer_for(device)(
            network,
            parameters.to(device),
            trajectories,
            self._schedule if timed else None,
            self._objective(),
            self._config.training,
            iterations,
            generator,
        )

    def _sided(self) -> bool:
        """Whether s may change its sign across the surface, and is to be told where."""
        plain = self._config.field == "mlp" and self._architecture.output == "abs"
        return plain and self._config.training.sided > 0

    def _objective(self) -> Objective:
        output, training = self._architecture.output, self._config.training
        if self._config.field == "cap-udf":
            return pull_objective(output, training.pull_loss)
        return trajectory_objective(output, training.value_weight)

    def run(self) -> Generator[int, None, NeuralFit]:
        """Trains; yields the number of iterations made, returns the fit.

        Raises:
            Diverged: the loss is not finite, even at a lower learning rate.
        """
        for report in self.trainer.run():
            self.loss = report.loss
            yield report.iteration
        return self.early()

    def early(self) -> NeuralFit:
        """The field as it is now."""
        parameters = self.trainer.parameters.clone()
        if self._config.field == "cap-udf":
            return NeuralFit(
                CapUdfField(self._architecture, parameters, self._reach, BOX), self.loss
            )
        return NeuralFit(
            MLPField(self._architecture, self._schedule, parameters, self._reach, BOX), self.loss
        )
