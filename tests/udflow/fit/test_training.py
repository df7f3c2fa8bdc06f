"""The training loop: it learns, goes on bit for bit, and knows what to do when it goes wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import torch
from shapes import Sphere
from torch import Tensor

from udflow.errors import BadField, Diverged
from udflow.fields import reference
from udflow.fields.network import Network, started
from udflow.fit.adam import Adam, optimiser_for, orthogonalised
from udflow.fit.objectives import Objective, pull_objective, trajectory_objective
from udflow.fit.queries import Trajectories, draw_trajectories, query_spread
from udflow.fit.training import (
    REPORT_EVERY,
    RecordedTrainer,
    Report,
    Trainer,
    learning_rate,
    matmul_precision,
    trainer_for,
)
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate, trajectory_loss
from udflow.neural_config import OPTIMISERS, OUTPUTS, NetworkConfig, TrainingConfig

NETWORK = Network(NetworkConfig(layers=4, width=24, skips=(2,), film=(0, 2)))
SCHEDULE = TimeSchedule(5)
LONG = 600  # iterations
TRAINING = TrainingConfig(
    iterations=300,
    batch=300,
    optimiser="adam",
    learning_rate=3e-3,
    warmup=50,
    queries=4_000,
    targets="points",
)


def trajectories(count: int = 4_000) -> Trajectories:
    samples = Sphere().sample(2_000)
    generator = torch.Generator().manual_seed(5)
    return draw_trajectories(samples, None, replace(TRAINING, queries=count), generator)


def trainer(
    config: TrainingConfig = TRAINING,
    objective: Objective | None = None,
    network: Network = NETWORK,
    schedule: TimeSchedule | None = SCHEDULE,
) -> Trainer:
    return Trainer(
        network,
        started(network, torch.Generator().manual_seed(0)),
        trajectories(),
        schedule,
        objective or trajectory_objective(network.config.output, config.value_weight),
        config,
        config.iterations,
        torch.Generator().manual_seed(1),
    )


def trained(subject: Trainer) -> list[Report]:
    with torch.inference_mode():
        return list(subject.run())


@cache
def long_run() -> tuple[Trainer, list[Report]]:
    """What several tests compare with or look at."""
    subject = trainer(replace(TRAINING, iterations=LONG))
    return subject, trained(subject)


def test_it_learns_and_reports() -> None:
    subject, reports = long_run()
    assert [r.iteration for r in reports] == list(range(REPORT_EVERY, LONG + 1, REPORT_EVERY))
    assert reports[-1].loss < 0.25 * reports[0].loss
    assert float(subject.parameters.isfinite().all()) == 1


def test_the_last_report_may_be_short() -> None:
    assert [r.iteration for r in trained(trainer(replace(TRAINING, iterations=130)))] == [100, 130]


def test_the_loss_curve_is_that_of_automatic_double_differentiation() -> None:
    """The same start, batches and optimiser, once by hand and once by autograd and torch's Adam."""
    config = replace(TRAINING, iterations=200)
    by_hand = trained(trainer(config))
    parameters = started(NETWORK, torch.Generator().manual_seed(0)).requires_grad_()
    optimiser = torch.optim.Adam([parameters], eps=1e-15)
    ends, generator = trajectories(), torch.Generator().manual_seed(1)
    t = torch.tensor(TimeSchedule(5).times).repeat_interleave(60)[:, None]
    losses: list[float] = []
    for iteration in range(config.iterations):
        batch = iteration % (len(ends) // 300)
        if batch == 0:
            order = torch.randperm(len(ends), generator=generator)
        rows = order[batch * 300 : (batch + 1) * 300]
        query, foot = ends.query[rows], ends.foot[rows]
        optimiser.param_groups[0]["lr"] = learning_rate(iteration, 200, config)
        optimiser.zero_grad()
        weights = NETWORK.views(parameters)
        v = reference.velocity(NETWORK, weights, interpolate(query, foot, t), t)
        loss = trajectory_loss(v, query, foot)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert by_hand[0].loss == pytest.approx(sum(losses[:100]) / 100, rel=0.02)
    assert by_hand[1].loss == pytest.approx(sum(losses[100:]) / 100, rel=0.05)


@pytest.mark.parametrize("stop", [100, 200])
def test_going_on_is_bit_for_bit_like_never_stopping(stop: int) -> None:
    whole = trainer()
    trained(whole)
    first = trainer()
    with torch.inference_mode():
        for report in first.run():
            if report.iteration == stop:
                state = first.state()
                break
        second = trainer()
        second.restore(state)
    reports = trained(second)
    assert [r.iteration for r in reports] == list(range(stop + 100, 301, 100))
    assert torch.equal(second.parameters, whole.parameters)
    assert torch.equal(second.optimiser.square, whole.optimiser.square)


def test_a_state_of_another_network_is_refused() -> None:
    state = trainer().state()
    other = trainer(network=Network(replace(NETWORK.config, width=16)))
    with pytest.raises(BadField, match="parameters"):
        other.restore(state)


class _FailsOnce:
    """A loss that is not a number in one iteration, the first time it comes there."""

    def __init__(self, when: int, times: int) -> None:
        self.when, self.times, self.calls = when, times, 0
        self.inner = trajectory_objective("abs")

    def __call__(self, s: Tensor, *rest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        self.calls += 1
        loss, by_value, by_slope = self.inner(s, *rest)
        if self.calls >= self.when and self.times > 0:
            self.times -= 1
            return loss * torch.nan, by_value * torch.nan, by_slope
        return loss, by_value, by_slope


def test_a_loss_that_is_no_number_is_taken_back() -> None:
    subject = trainer(objective=_FailsOnce(when=150, times=1))
    reports = trained(subject)
    assert [r.iteration for r in reports] == [100, 200, 300]
    assert subject.rate_scale == 0.5
    assert bool(subject.parameters.isfinite().all())


def test_it_gives_up_in_words() -> None:
    with pytest.raises(Diverged, match=r"not finite.*a smaller training\.learning_rate"):
        trained(trainer(objective=_FailsOnce(when=150, times=10_000)))


def test_a_silent_network_is_said() -> None:
    rectified = Network(replace(NETWORK.config, output="relu"))
    subject = trainer(network=rectified)
    with torch.inference_mode():
        rectified.views(subject.parameters)["output.bias"].fill_(-9.0)
        subject._good = subject._snapshot()
    with pytest.raises(Diverged, match=r'the network was silent.*choose network\.output "abs"'):
        trained(subject)


@pytest.mark.parametrize("size", [1.0, 1e-19, 1e-37, 0.0])
def test_small_matrices_are_orthogonalised_as_large_ones(size: float) -> None:
    matrix = torch.randn(1, 8, 8, generator=torch.Generator().manual_seed(2))
    turned = orthogonalised(size * matrix)
    expected = orthogonalised(matrix) if size > 0 else torch.zeros(1, 8, 8)
    torch.testing.assert_close(turned, expected, rtol=1e-4, atol=1e-4)


def test_the_learning_rate_rises_and_falls() -> None:
    config = TrainingConfig(learning_rate=1e-3, warmup=1_000)
    rates = [learning_rate(i, 60_000, config) for i in range(60_000)]
    assert rates[0] == pytest.approx(1e-6)
    assert max(rates) == rates[999] == pytest.approx(1e-3)
    assert rates[30_500] == pytest.approx(5e-4, rel=1e-3)
    assert 0 < rates[-1] < 1e-9
    assert learning_rate(0, 3, config) == 1e-3  # a warm-up longer than the training is cut


def test_adam_is_adam() -> None:
    generator = torch.Generator().manual_seed(0)
    ours = torch.randn(50, generator=generator)
    theirs = ours.clone().requires_grad_()
    adam, optimiser = Adam(ours), torch.optim.Adam([theirs], lr=0.01, eps=1e-15)
    for _ in range(20):
        gradient = torch.randn(50, generator=generator)
        adam.prepare(0.01)
        adam.step(gradient)
        theirs.grad = gradient.clone()
        optimiser.step()
    torch.testing.assert_close(ours, theirs.detach())


def test_moments_of_the_dead_do_not_end_as_denormal_numbers() -> None:
    parameters = torch.zeros(4)
    adam, gradient = Adam(parameters), torch.tensor([1e-3, 1e-3, 1e-3, 0.0])
    for step in range(1, 1_201):
        adam.prepare(1e-3)
        adam.step(gradient if step == 1 else gradient * torch.tensor([1.0, 0.0, 0.0, 0.0]))
        if step % 100 == 0:
            adam.settle()
    smallest = torch.finfo(torch.float32).tiny
    assert float(adam.mean[0]) == pytest.approx(1e-3)
    for moment in (adam.mean, adam.square):
        assert bool(((moment == 0) | (moment >= smallest)).all())
    assert adam.mean[1:].tolist() == [0, 0, 0]


def test_muon_moves_hidden_matrices_along_orthogonal_ones_and_the_rest_like_adam() -> None:
    generator = torch.Generator().manual_seed(0)
    start = started(NETWORK, generator)
    gradient = torch.randn(NETWORK.size, generator=generator)
    moved = {}
    for kind in OPTIMISERS:
        parameters = start.clone()
        optimiser = optimiser_for(kind, parameters, NETWORK)
        optimiser.prepare(0.01)
        optimiser.step(gradient)
        moved[kind] = NETWORK.views(parameters - start)
    for name, change in moved["muon"].items():
        if name in ("layer1.weight", "layer2.weight", "layer3.weight"):
            values = torch.linalg.svdvals(change) / (0.01 * 0.2 * 24**0.5)
            assert 0.7 < float(values.median()) <= float(values.max()) < 1.3
        else:
            torch.testing.assert_close(change, moved["adam"][name])


def test_muon_learns_sooner() -> None:
    (muon,) = set(OPTIMISERS) - {TRAINING.optimiser}
    loss = trained(trainer(replace(TRAINING, optimiser=muon, iterations=LONG)))[-1].loss
    assert loss < long_run()[1][-1].loss


def test_bfloat16_products_learn_the_same() -> None:
    low = trained(trainer(replace(TRAINING, iterations=LONG, precision="bfloat16")))[-1].loss
    assert low < 2 * long_run()[1][-1].loss


def test_precision_is_as_it_was_afterwards() -> None:
    before = torch.get_float32_matmul_precision()
    with matmul_precision("tf32"):
        assert torch.get_float32_matmul_precision() == "high"
    assert torch.get_float32_matmul_precision() == before


@pytest.mark.parametrize(
    ("changes", "objective", "sided"),
    [
        ({}, None, False),
        ({}, None, True),
        ({"optimiser": "muon"}, None, True),
        ({"precision": "bfloat16"}, None, False),
        ({}, pull_objective("abs", "chamfer"), False),
        ({}, pull_objective("abs", "points"), False),
    ],
    ids=["plain", "sides", "muon", "bfloat16", "unpaired", "pairs"],
)
def test_one_step_only_launches_kernels(
    changes: dict[str, Any],
    objective: Objective | None,
    sided: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a CUDA graph records must not ask the device for a number. There need not be a GPU
    here: every way of a tensor's own to a number of the host is closed for one step."""
    subject = trainer(replace(TRAINING, **changes), objective)
    ends = subject._trajectories
    side = torch.ones(len(ends)) if sided else None
    subject._trajectories = replace(ends, side=side)

    def refused(self: Tensor, *_: object) -> float:
        raise AssertionError("a number was asked of the device inside a step")

    with torch.inference_mode():
        subject._advance()
        closed = ("item", "__float__", "__int__", "__bool__", "tolist", "numpy", "cpu", "nonzero")
        for name in closed:
            monkeypatch.setattr(Tensor, name, refused)
        subject._one_step()


def test_a_cuda_device_records_its_step() -> None:
    assert trainer_for(torch.device("cuda")) is RecordedTrainer
    assert trainer_for(torch.device("cpu")) is Trainer


def test_a_step_is_recorded_once_also_where_a_training_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recorded: list[int] = []
    monkeypatch.setattr(RecordedTrainer, "_record", lambda self: recorded.append(self.iteration))
    monkeypatch.setitem(globals(), "Trainer", RecordedTrainer)
    stopped = trainer()
    with torch.inference_mode():
        next(stopped.run())
        again = trainer()
        again.restore(stopped.state())
        next(again.run())
    assert recorded == [3, REPORT_EVERY + 3]


@pytest.mark.skipif(
    not torch.cuda.is_available(), reason="needs a CUDA device; structure only here"
)
def test_a_recorded_step_is_the_same_step() -> None:
    cpu = trained(trainer())
    ends = trajectories()
    subject = RecordedTrainer(
        NETWORK,
        started(NETWORK, torch.Generator().manual_seed(0)).cuda(),
        Trajectories(ends.query.cuda(), ends.foot.cuda(), ends.reach),
        TimeSchedule(5),
        trajectory_objective("abs"),
        TRAINING,
        TRAINING.iterations,
        torch.Generator().manual_seed(1),
    )
    assert trained(subject)[0].loss == pytest.approx(cpu[0].loss, rel=0.05)


def test_queries_spread_as_the_samples_lie() -> None:
    samples = Sphere().sample(3_000)
    spread = query_spread(samples, 0.25)
    radius = (50 / (3_000 / torch.pi)) ** 0.5 / torch.pi**0.5
    assert float(spread.mean()) == pytest.approx(0.25 * radius, rel=0.1)
    dense = query_spread(Sphere().sample(45_000), 0.25)
    assert float(dense.mean()) == pytest.approx(0.25 * radius * (3 / 45) ** 0.5 * 1.5, rel=0.1)


def test_trajectories_end_at_the_nearest_sample() -> None:
    samples = Sphere().sample(500)
    found = draw_trajectories(
        samples, None, replace(TRAINING, queries=1_000, far=0.2), torch.Generator().manual_seed(0)
    )
    assert len(found) == 1_000
    distance = torch.cdist(found.query, samples).min(dim=1).values
    torch.testing.assert_close((found.query - found.foot).norm(dim=1), distance, atol=1e-5, rtol=0)
    assert float(found.query[800:].abs().max()) > 1.2
    assert float(distance[:800].max()) < 0.5


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("kind", ["trajectory", "valued", "points", "chamfer"])
def test_derivatives_of_the_losses(kind: str, output: str) -> None:
    objective = {
        "trajectory": trajectory_objective(output),  # type: ignore[arg-type]
        "valued": trajectory_objective(output, 0.5),  # type: ignore[arg-type]
        "points": pull_objective(output, "points"),  # type: ignore[arg-type]
        "chamfer": pull_objective(output, "chamfer"),  # type: ignore[arg-type]
    }[kind]
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    s, slope, query, foot = 0.1 * draw(12), draw(12, 3), draw(12, 3), draw(12, 3)
    t = torch.full((12,), 0.4, dtype=torch.float64)
    _, by_value, by_slope = objective(s, slope, query, foot, t)

    def total(s: Tensor, slope: Tensor) -> Tensor:
        loss = objective(s, slope, query, foot, t)[0]
        if kind == "valued":  # the loss returned is that of equation (3) alone
            from udflow.fields.outputs import output_value

            d = output_value(output, s)  # type: ignore[arg-type]
            loss = loss + 0.5 * (d - t.sqrt() * (query - foot).norm(dim=1)).square().mean()
        return loss

    for found, wanted in ((by_value, s), (by_slope, slope)):
        for index in range(wanted.numel()):
            step = torch.zeros_like(wanted)
            step.view(-1)[index] = 1e-6
            ends = [
                (s + k * step, slope) if wanted is s else (s, slope + k * step) for k in (1, -1)
            ]
            slope_of_loss = (total(*ends[0]) - total(*ends[1])) / 2e-6
            assert float(found.reshape(-1)[index]) == pytest.approx(
                float(slope_of_loss), rel=1e-4, abs=1e-7
            )
