"""Sides of the surface, guessed: the same for all queries that can see each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from shapes import Cube, MoebiusStrip, Shape, Sphere, Torus, TwoSheets
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config
from udflow.fields import reference
from udflow.fields.network import Network, started
from udflow.fit.neural import NeuralFitting
from udflow.fit.objectives import by_side, trajectory_objective
from udflow.fit.queries import Trajectories
from udflow.fit.sides import sides
from udflow.fit.training import Trainer
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate, trajectory_loss
from udflow.neural_config import NetworkConfig, Output, TrainingConfig

NETWORK = NetworkConfig(layers=4, width=24, skips=(2,), film=(0, 2))
TRAINING = TrainingConfig(iterations=9, batch=100, warmup=0, queries=4_000, sided=3)
CONFIG = Config(field="mlp", network=NETWORK, training=TRAINING)


def around(samples: Tensor, spread: float = 0.01) -> Tensor:
    """Four queries around each sample, in random order."""
    generator = torch.Generator().manual_seed(0)
    order = torch.randperm(4 * len(samples), generator=generator)
    noise = spread * torch.randn(len(order), 3, generator=generator)
    return (samples.repeat(4, 1) + noise)[order]


def guessed(shape: Shape, count: int = 1_500) -> tuple[Tensor, Tensor]:
    """Queries around samples of a shape, and their sides."""
    samples = shape.sample(count)
    surface, query = SampledSurface.of(samples), around(samples)
    return query, sides(surface.surface, query, surface.project(query))


def agreement(side: Tensor, truth: Tensor) -> float:
    """Share of signs that are those of the truth, or all the opposite."""
    same = float((side == torch.where(truth, 1.0, -1.0)).float().mean())
    return max(same, 1 - same)


def test_inside_and_outside_of_closed_surfaces_differ() -> None:
    query, side = guessed(Sphere())
    assert agreement(side, query.norm(dim=1) < 0.5) > 0.99
    query, side = guessed(Torus())
    core = query[:, :2].norm(dim=1) - 0.35
    assert agreement(side, core.square() + query[:, 2].square() < 0.15**2) > 0.99


def test_they_differ_across_edges_and_corners_too() -> None:
    query, side = guessed(Cube(), 3_000)
    assert agreement(side, (query.abs() < 0.5).all(dim=1)) > 0.98


def test_between_two_sheets_there_is_one_side() -> None:
    """Sheets that do not touch are brought into agreement through the space between them."""
    query, side = guessed(TwoSheets(gap=0.06), 3_000)
    assert agreement(side, query[:, 2].abs() < 0.03) > 0.99


def test_a_surface_with_one_side_is_cut_somewhere_and_no_more() -> None:
    """On a Moebius strip no signs can be right everywhere; near any other place they are."""
    shape = MoebiusStrip()
    query, side = guessed(shape)
    assert set(side.tolist()) == {-1.0, 1.0}
    offset = query - shape.closest(query)
    near = torch.cdist(query, query).topk(8, largest=False).indices
    same = (offset[near] * offset[:, None]).sum(dim=2) > 0
    wrong = (side[near] == side[:, None]) != same
    assert float(wrong.float().mean()) < 0.1


def test_the_derivative_is_that_of_the_squared_excess() -> None:
    generator = torch.Generator().manual_seed(0)
    s = torch.randn(9, generator=generator, dtype=torch.float64)
    query, foot = torch.randn(2, 9, 3, generator=generator, dtype=torch.float64)
    t, side = (
        torch.full((9,), 0.4, dtype=torch.float64),
        torch.tensor([1.0, -1.0, 1.0] * 3).double(),
    )

    def loss(s: Tensor) -> Tensor:
        return (s - side * 0.4**0.5 * (query - foot).norm(dim=1)).square()

    found = by_side(s, query, foot, t, side)
    torch.testing.assert_close(found, (loss(s + 1e-6) - loss(s - 1e-6)) / 2e-6)


def one_batch(sided: int) -> tuple[Trainer, Tensor]:
    """A trainer whose batch is all it has, s > 0 everywhere; and its parameters before."""
    network = Network(NETWORK)
    parameters = started(network, torch.Generator().manual_seed(0))
    network.views(parameters)["output.bias"].fill_(1.0)
    foot = Sphere().sample(100)
    query = foot + 0.02 * torch.randn(100, 3, generator=torch.Generator().manual_seed(1))
    side = torch.where(query.norm(dim=1) < 0.5, -1.0, 1.0)
    return Trainer(
        network,
        parameters,
        Trajectories(query, foot, 0.02, side),
        TimeSchedule(5),
        trajectory_objective("abs"),
        replace(TRAINING, sided=sided),
        TRAINING.iterations,
        torch.Generator().manual_seed(2),
    ), parameters.clone()


@pytest.mark.parametrize("sided", [1, 0])
def test_the_first_iterations_also_learn_the_side(sided: int) -> None:
    """The gradient of a step, beside automatic differentiation of both losses."""
    subject, before = one_batch(sided)
    with torch.inference_mode():
        subject._advance()
    ends, rows = subject._trajectories, subject._index.clone()
    assert ends.side is not None
    query, foot, t = ends.query[rows], ends.foot[rows], subject._row_times.clone()
    before.requires_grad_()
    weights, state = subject.network.views(before), interpolate(query, foot, t)
    v = reference.velocity(subject.network, weights, state, t)
    s = reference.distance(subject.network, weights, state, t)  # s itself, where it is positive
    wanted = ends.side[rows] * t[:, 0].sqrt() * (query - foot).norm(dim=1)
    loss = trajectory_loss(v, query, foot) + sided * (s - wanted).square().mean()
    loss.backward()
    torch.testing.assert_close(subject._gradient, before.grad, rtol=1e-3, atol=1e-5)


def test_later_iterations_do_not() -> None:
    subject, _ = one_batch(sided=2)
    weights = []
    with torch.inference_mode():
        for _ in range(3):
            subject._advance()
            weights.append(float(subject._side_weight))
    assert weights == pytest.approx([0.01, 0.01, 0.0])


def fitted(config: Config, first: bool = True) -> Tensor:
    samples = Sphere().sample(1_000)
    with torch.inference_mode():
        surface, generator = SampledSurface.of(samples), torch.Generator().manual_seed(0)
        iterations = config.training.iterations
        fitting = NeuralFitting(samples, surface, config, iterations, None, generator, first)
        for _ in fitting.run():
            pass
        return fitting.early().field.parameters


@pytest.mark.parametrize("reason", ["later fit", "an output that has one sign", "none"])
def test_nothing_is_told_where_it_would_not_fit(reason: str) -> None:
    output: Output = "softplus" if reason.startswith("an output") else "abs"
    config = replace(CONFIG, network=replace(NETWORK, output=output))
    unsided = replace(config, training=replace(TRAINING, sided=0))
    told = fitted(config, first=reason != "later fit")
    assert torch.equal(told, fitted(unsided)) == (reason != "none")
