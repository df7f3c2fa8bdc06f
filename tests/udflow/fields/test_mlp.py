"""Trained fields: conservative, projecting, and told apart from what they do not know."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import pytest
import torch
from shapes import Sphere
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, DensifyConfig, FlowConfig
from udflow.densify import Round, reflow_round
from udflow.fields.cap_udf import CapUdfField
from udflow.fields.mlp import MLPField
from udflow.fields.unsigned import SurfaceField
from udflow.fit.neural import NeuralFit, NeuralFitting, iterations_of
from udflow.flow.integrate import integrate_reverse
from udflow.neural_config import OUTPUTS, NetworkConfig, Output, TrainingConfig

NETWORK = NetworkConfig(layers=4, width=32, skips=(2,), film=(0, 2))
TRAINING = TrainingConfig(
    iterations=600, batch=600, learning_rate=5e-3, warmup=50, queries=20_000, targets="points"
)
CONFIG = Config(field="mlp", network=NETWORK, training=TRAINING)
SAMPLES = Sphere().sample(3_000)


@lru_cache
def fitted(config: Config) -> NeuralFit:
    """A sphere, trained for a moment."""
    with torch.inference_mode():
        generator = torch.Generator().manual_seed(0)
        surface = SampledSurface.of(SAMPLES)
        iterations = config.training.iterations
        fitting = NeuralFitting(SAMPLES, surface, config, iterations, None, generator)
        for _ in fitting.run():
            pass
        return fitting.early()


def field_of(config: Config = CONFIG) -> MLPField:
    field = fitted(config).field
    assert isinstance(field, MLPField)
    return field


def near(count: int, offset: float = 0.02, seed: int = 3) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return Sphere().sample(count, seed) + offset * torch.randn(count, 3, generator=generator)


def curl(field: MLPField, points: Tensor, t: float) -> tuple[Tensor, Tensor]:
    """Central differences: (n,) length of the curl and of the whole Jacobian, in doubles."""
    exact = replace(field, parameters=field.parameters.double())
    jacobian = torch.empty(len(points), 3, 3, dtype=torch.float64)
    for axis in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[axis] = 1e-7
        ahead, behind = (exact.velocity(points.double() + k * step, t) for k in (1, -1))
        jacobian[:, :, axis] = (ahead - behind) / 2e-7
    antisymmetric = jacobian - jacobian.mT
    return antisymmetric.flatten(1).norm(dim=1), jacobian.flatten(1).norm(dim=1)


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("t", [1 / 15, 1.0])
def test_lemma_one_the_velocity_has_no_curl(output: Output, t: float) -> None:
    """Of a trained field; its weights are those for |s|, since the other outputs fall silent on
    a sphere. Points where a rectifier bends within the step (a few) are left out, and so are those
    where the velocity does not change, as where a rectified d is 0."""
    field = replace(field_of(), config=replace(NETWORK, output=output))
    turning, changing = curl(field, near(400), t)
    alive = changing > 0.01
    assert float(alive.float().mean()) > 0.2
    whole = turning < 1e-4 * (changing + 1e-3)
    assert float(whole[alive].float().mean()) > 0.97
    assert float(changing.max()) > 0.1


def test_a_field_that_is_no_gradient_is_noticed() -> None:
    """The same measure finds the curl of a field that has one."""

    class Turning(MLPField):
        def velocity(self, points: Tensor, t: float) -> Tensor:
            v = super().velocity(points, t)
            return v + torch.stack([-points[:, 1], points[:, 0], 0 * points[:, 2]], dim=1)

    plain = field_of()
    turning = Turning(plain.config, plain.schedule, plain.parameters, plain.reach, 1.5)
    assert float(curl(turning, near(50), 1.0)[0].min()) > 1


def test_it_projects_onto_what_it_was_trained_to() -> None:
    points = near(1_000)
    before = Sphere().distance(points)
    after = Sphere().distance(field_of().project(points))
    assert float(after.mean()) < 0.4 * float(before.mean())


def test_projecting_is_equation_four() -> None:
    field, points = field_of(), near(50)
    feet = integrate_reverse(field.velocity, points, field.schedule)
    assert torch.equal(field.project(points), feet)
    torch.testing.assert_close(field.distance(points), (points - feet).norm(dim=1))
    gradient = field.gradient(points)
    torch.testing.assert_close(gradient.norm(dim=1), torch.ones(50))
    torch.testing.assert_close(gradient * field.distance(points)[:, None], points - feet)


def test_the_velocity_is_the_gradient_of_half_the_squared_value() -> None:
    field = replace(field_of(), parameters=field_of().parameters.double())
    points, direction = near(100).double(), torch.tensor([0.6, 0.0, 0.8]).double()
    energy = [0.5 * field.value(points + k * direction, 0.4) ** 2 for k in (1e-6, -1e-6)]
    along = (field.velocity(points, 0.4) * direction).sum(dim=1)
    torch.testing.assert_close((energy[0] - energy[1]) / 2e-6, along, rtol=1e-4, atol=1e-6)


def test_far_away_its_own_word_is_not_taken() -> None:
    field = field_of()
    surface = SampledSurface.of(SAMPLES).surface
    sites = NeighbourTree(SAMPLES)
    far = torch.tensor([[0.0, 0.0, 1.2], [0.0, 0.0, 0.0]])
    assert not bool(field.answers(far, sites)[1].any())
    feet, trusted = field.answers(SAMPLES[:9], sites)
    assert bool(trusted.all())
    assert torch.equal(feet, field.project(SAMPLES[:9]))
    feet = SurfaceField(field, surface).project(far)
    assert float(Sphere().distance(feet).max()) < 0.02


def test_many_points_are_answered_like_few() -> None:
    field, points = field_of(), near(5_000)
    whole = field.velocity(points, 1.0)
    parts = torch.cat([field.velocity(part, 1.0) for part in points.split(1_700)])
    torch.testing.assert_close(whole, parts, rtol=1e-4, atol=1e-6)
    assert field.velocity(points[:0], 1.0).shape == (0, 3)


def test_the_same_seed_gives_the_same_field() -> None:
    config = replace(CONFIG, training=replace(TRAINING, iterations=100))
    first = fitted(config).field.parameters
    fitted.cache_clear()
    assert torch.equal(fitted(config).field.parameters, first)
    other = fitted(replace(config, seed=1)).field.parameters
    assert not torch.equal(other, first)


@pytest.mark.parametrize("steps", [1, 3, 10])
def test_any_number_of_steps(steps: int) -> None:
    training = replace(TRAINING, iterations=100)
    field = field_of(replace(CONFIG, flow=FlowConfig(steps), training=training))
    assert field.schedule.steps == steps
    assert bool(field.project(near(10)).isfinite().all())


def test_iterations_are_shared_by_the_rounds() -> None:
    assert iterations_of(0, 0, CONFIG) == 600
    assert [iterations_of(n, 3, CONFIG) for n in range(4)] == [300, 100, 100, 100]
    assert iterations_of(1, 10_000, CONFIG) == 1


@pytest.mark.parametrize("loss", ["points", "chamfer"])
def test_a_cap_udf_field_is_a_field(loss: str) -> None:
    training = replace(TRAINING, pull_loss=loss)  # type: ignore[type-var]
    config = replace(CONFIG, field="cap-udf", training=training)
    field = fitted(config).field
    assert isinstance(field, CapUdfField)
    points = near(1_000)
    feet = field.project(points)
    assert float(Sphere().distance(feet).mean()) < 0.7 * float(Sphere().distance(points).mean())
    assert float(field.distance(points).min()) >= 0
    torch.testing.assert_close(field.gradient(points).norm(dim=1), torch.ones(1_000))
    config = DensifyConfig(target_points=4_000, points_per_round=500, threshold=0.02)
    before, generator = Round(0, SAMPLES, 0), torch.Generator().manual_seed(0)
    after = reflow_round(before, SAMPLES, field, config, generator)
    assert after.added == 500
    assert float(Sphere().distance(after.samples[3_000:]).mean()) < 0.01
    once = points - field.distance(points)[:, None] * field.gradient(points)
    torch.testing.assert_close(field.refine(points), once)
    assert torch.equal(field.velocity(points, 0.1), field.velocity(points, 1.0))
