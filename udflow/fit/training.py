"""The training loop: batches, the gradient by hand, Adam, and what to do when it goes wrong."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.errors import Diverged
from udflow.fields.network import Network
from udflow.fields.outputs import output_factor
from udflow.fields.passes import Pass, TimedNetwork
from udflow.fit.adam import optimiser_for
from udflow.fit.objectives import Objective, by_side
from udflow.fit.queries import Trajectories
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate
from udflow.neural_config import Precision, TrainingConfig

REPORT_EVERY = 100  # iterations between two looks at the loss: a look waits for the device
_SIDED_SHARE = 3  # a start with sides takes no more than one of so many parts
_RETRIES = 3  # times a fit that is not finite goes back and tries half the learning rate


@dataclass(frozen=True)
class Report:
    """A moment of a training.

    Attributes:
        iteration: iterations made.
        loss: mean over the iterations since the last report.
    """

    iteration: int
    loss: float


def learning_rate(iteration: int, iterations: int, config: TrainingConfig) -> float:
    """Linear warm-up, then half a cosine down to zero. `iteration` counts from 0."""
    warmup = min(config.warmup, iterations // 4)
    if iteration < warmup:
        return config.learning_rate * (iteration + 1) / warmup
    turn = (iteration - warmup) / max(iterations - warmup, 1)
    return config.learning_rate * 0.5 * (1 + math.cos(math.pi * turn))


class Trainer:
    """A network in training on a fixed set of trajectories.

    Args:
        network: the architecture.
        parameters: (size,) float32 on the device; changed in place.
        trajectories: ends of the trajectories, on the device.
        schedule: times of the states; None trains at the queries themselves, without time.
        objective: loss and derivatives.
        config: rate, batch and precision.
        iterations: to make.
        generator: order of the batches; on the CPU.
    """

    def __init__(
        self,
        network: Network,
        parameters: Tensor,
        trajectories: Trajectories,
        schedule: TimeSchedule | None,
        objective: Objective,
        config: TrainingConfig,
        iterations: int,
        generator: torch.Generator,
    ) -> None:
        self.network = network
        self.parameters = parameters
        self.optimiser = optimiser_for(config.optimiser, parameters, network)
        self.iteration = 0
        self.iterations = iterations
        self.generator = generator
        self.rate_scale = 1.0
        self._trajectories = trajectories
        self._objective = objective
        self._config = config
        self._prepare_batches(schedule, config.batch)
        self._prepare_products(config)
        self._order_state = generator.get_state()
        self._order = torch.empty(0, dtype=torch.int64)
        self._loss = parameters.new_zeros(())
        self._step = self._one_step
        self._good = self._snapshot()

    def _prepare_batches(self, schedule: TimeSchedule | None, batch: int) -> None:
        times = schedule.times if schedule is not None else (1.0,)
        per_time = min(batch, len(self._trajectories)) // len(times)
        self._rows = per_time * len(times)
        self._batches = len(self._trajectories) // self._rows
        self._times = self.parameters.new_tensor(times)
        self._row_times = self._times.repeat_interleave(per_time)[:, None]
        self._factor = output_factor(self.network.config.scale, self._row_times[:, 0])
        self._index = torch.zeros(self._rows, dtype=torch.int64, device=self.parameters.device)
        self._sided = min(self._config.sided, self.iterations // _SIDED_SHARE)
        self._side_weight = self.parameters.new_zeros(())

    def _prepare_products(self, config: TrainingConfig) -> None:
        low = config.precision == "bfloat16"
        products = self.parameters.bfloat16() if low else self.parameters
        self._products = products  # the parameters themselves, or their copy in low precision
        self._gradient = torch.zeros_like(products)
        self._room = Pass(self.network, self._rows, products)

    def run(self) -> Generator[Report, None, None]:
        """Trains to the end; yields after every `REPORT_EVERY` iterations and after the last.

        Raises:
            Diverged: the loss is not finite or the network silent, even at an eighth of the
                learning rate.
        """
        with matmul_precision(self._config.precision):
            while self.iteration < self.iterations:
                since = self.iteration
                for _ in range(min(REPORT_EVERY, self.iterations - since)):
                    self._advance()
                self.optimiser.settle()
                loss = float(self._loss) / (self.iteration - since)
                self._loss.zero_()
                wrong = self._what_is_wrong(loss)
                if wrong is None:
                    self._good = self._snapshot()
                    yield Report(self.iteration, loss)
                else:
                    self._go_back(wrong)

    def _advance(self) -> None:
        """One iteration, without waiting for the device."""
        self._index.copy_(self._next_rows(), non_blocking=True)
        rate = learning_rate(self.iteration, self.iterations, self._config)
        self.optimiser.prepare(rate * self.rate_scale)
        self._side_weight.fill_(1 / self._rows if self.iteration < self._sided else 0.0)
        self._step()
        self.iteration += 1

    def _next_rows(self) -> Tensor:
        """Rows of the next batch: all trajectories in random order, then in another order."""
        number = self.iteration % self._batches
        if number == 0 or len(self._order) == 0:
            self._new_order()
        return self._order[number * self._rows : (number + 1) * self._rows]

    def _new_order(self) -> None:
        self._order_state = self.generator.get_state()
        order = torch.randperm(len(self._trajectories), generator=self.generator)
        if self.parameters.is_cuda:
            order = order.pin_memory()
        self._order = order.to(self.parameters.device, non_blocking=True)

    def _next_order_state(self) -> Tensor:
        """State of the generator from which the order of the next batch follows."""
        between = self.iteration % self._batches == 0
        return self.generator.get_state() if between else self._order_state.clone()

    def _one_step(self) -> None:
        """Loss, gradient and update, as kernels on the device and nothing else."""
        query = self._trajectories.query[self._index]
        foot = self._trajectories.foot[self._index]
        state = interpolate(query, foot, self._row_times)
        if self._products is not self.parameters:
            self._products.copy_(self.parameters)
        weights = self.network.views(self._products)
        timed = TimedNetwork.at(self.network, weights, self._times.to(self._products.dtype))
        value, slope = self._room.run(timed, state)
        factor, t = self._factor, self._row_times[:, 0]
        s = value * factor
        loss, by_value, by_slope = self._objective(s, slope * factor[:, None], query, foot, t)
        if self._trajectories.side is not None:
            side = self._trajectories.side[self._index]
            by_value = by_value + self._side_weight * by_side(s, query, foot, t, side)
        self._room.pull_back(
            by_value * factor, by_slope * factor[:, None], self.network.views(self._gradient)
        )
        self.optimiser.step(self._gradient.to(self.parameters.dtype))
        self._loss += loss

    def _snapshot(self) -> dict[str, Tensor]:
        """Copies of all that training changes and that lives on the device."""
        return {
            "parameters": self.parameters.clone(),
            "mean": self.optimiser.mean.clone(),
            "square": self.optimiser.square.clone(),
            "order": self._next_order_state(),
            "counts": torch.tensor([self.iteration, self.optimiser.steps]),
        }

    def state(self) -> dict[str, Tensor]:
        """Everything that `restore` needs to go on bit for bit, trajectories apart."""
        rate_scale = torch.tensor([self.rate_scale], dtype=torch.float64)
        return {**self._snapshot(), "rate_scale": rate_scale}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Goes on where a trainer with the same arguments gave `state`.

        Raises:
            BadField: tensors of another size.
        """
        self.network.views(state["parameters"])
        for target, name in (
            (self.parameters, "parameters"),
            (self.optimiser.mean, "mean"),
            (self.optimiser.square, "square"),
        ):
            target.copy_(state[name])
        self.iteration, self.optimiser.steps = (int(n) for n in state["counts"])
        self.rate_scale = float(state.get("rate_scale", torch.tensor([self.rate_scale])))
        self.generator.set_state(state["order"].cpu())
        self._order = self._order[:0]
        self._order_state = state["order"].cpu()
        if self.iteration % self._batches:  # the order under way: what follows it must find
            self._new_order()  # the generator as it was
        self._good = self._snapshot()

    def _what_is_wrong(self, loss: float) -> str | None:
        """Why training cannot go on from here."""
        if not math.isfinite(loss):
            return "the loss was not finite"
        if not bool(self._gradient.any()):  # a rectified output below 0 everywhere
            return "the network was silent, with nothing left to learn from,"
        return None

    def _go_back(self, wrong: str) -> None:
        """To the last report at which all was well, with half the learning rate."""
        if self.rate_scale <= 0.5**_RETRIES:
            raise Diverged(
                f"{wrong} after {self.iteration} iterations, even with the learning rate lowered "
                f'{_RETRIES} times; choose network.output "abs", a smaller training.learning_rate '
                "or training.precision float32"
            )
        rate_scale = self.rate_scale / 2
        self.restore(self._good)
        self.rate_scale = rate_scale


class RecordedTrainer(Trainer):
    """A trainer on a CUDA device whose step is recorded once and then replayed: one launch instead
    of hundreds, and no word from the host but the rows and the learning rate."""

    _EAGER = 3  # steps before recording, so that libraries have set themselves up
    _eager = 0  # made so far

    def _advance(self) -> None:
        if self._eager == self._EAGER:
            self._record()
        super()._advance()
        self._eager += 1

    def _record(self) -> None:
        """From now on a step is the replay of this one."""
        self._graph = torch.cuda.CUDAGraph()
        torch.cuda.synchronize()
        with torch.cuda.graph(self._graph):
            self._one_step()
        self._step = self._graph.replay


def trainer_for(device: torch.device) -> type[Trainer]:
    """The kind of trainer that suits a device."""
    return RecordedTrainer if device.type == "cuda" else Trainer


@contextlib.contextmanager
def matmul_precision(precision: Precision) -> Iterator[None]:
    """TF32 for products of float32 matrices where asked for, and as it was afterwards."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high" if precision == "tf32" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)
