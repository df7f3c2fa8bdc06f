"""Fitted fields against exact distances, shape by shape."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from fits import SMALL, Fitted, fit, fitted
from shapes import Hemisphere, MoebiusStrip, PlanePatch, Shape, Sphere, Torus, TwoSheets
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, ExtractConfig, FlowConfig, SplineConfig
from udflow.fields.storage import field_to_bytes
from udflow.fit.spline import finest_resolution, fit_spline, smoothness, trajectories
from udflow.flow.schedule import TimeSchedule
from udflow.flow.trajectory import interpolate, trajectory_loss


def beside(shape: Shape, reach: float, count: int = 3000) -> Tensor:
    """Points up to `reach` from the surface."""
    generator = torch.Generator().manual_seed(3)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator))
    length = reach * torch.rand(count, 1, generator=generator)
    return shape.sample(count, seed=9) + length * direction


class Dome(Hemisphere):
    """A hemisphere away from its rim."""

    def sample(self, count: int, seed: int = 0) -> Tensor:
        points = super().sample(2 * count, seed)
        return points[points[:, 2] > 0.1][:count]


# a shape, the part of it that lies away from rims, and the mean error allowed near that part, in
# 1e-4 of the extent: what 2 000 samples reach, and half as much again
REACHED = [
    pytest.param(Sphere(), Sphere(), 3.7, id="sphere"),
    pytest.param(Torus(), Torus(), 5.0, id="torus"),
    pytest.param(PlanePatch(), PlanePatch(half=0.4), 0.02, id="plane"),
    pytest.param(Hemisphere(), Dome(), 3.2, id="hemisphere"),
    pytest.param(MoebiusStrip(), MoebiusStrip(half=0.07), 1.7, id="moebius"),
    pytest.param(TwoSheets(gap=0.15), TwoSheets(gap=0.15, half=0.4), 0.05, id="sheets"),
]


@pytest.mark.parametrize(("shape", "inner", "allowed"), REACHED)
def test_near_the_surface(shape: Shape, inner: Shape, allowed: float) -> None:
    field = fitted(shape).field
    points = beside(inner, 0.03)
    feet = field.project(points)
    error = ((points - feet).norm(dim=1) - shape.distance(points)).abs()
    assert float(error.mean()) < 1e-4 * allowed
    assert float(shape.distance(feet).mean()) < 1e-4 * allowed
    assert float(error.quantile(0.99)) < 1e-4 * max(5 * allowed, 1)


@pytest.mark.parametrize("shape", [Sphere(), Torus()], ids=["sphere", "torus"])
def test_anywhere_in_the_box(shape: Shape) -> None:
    field = fitted(shape).placed()
    points = np.random.default_rng(1).uniform(-1.4, 1.4, (3000, 3))
    error = np.abs(field.query(points).distance - shape.distance(torch.from_numpy(points)).numpy())
    assert error.mean() < 6e-4
    assert np.quantile(error, 0.99) < 3e-3


def test_between_sheets_distances_are_not_blurred() -> None:
    """Half way between two sheets is where a smooth energy is at its worst."""
    shape = TwoSheets(gap=0.15)
    points = TwoSheets(gap=0.15, half=0.4).sample(1000, seed=9).double()
    points[:, 2] = torch.linspace(-0.5, 0.5, 1000).double() * shape.gap
    answer = fitted(shape).placed().query(points.numpy())
    error = np.abs(answer.distance - shape.distance(points).numpy())
    assert error.mean() < 1e-4


def test_beyond_a_rim_the_surface_ends_soon() -> None:
    """A few sample spacings beyond its rim nothing is left of a hemisphere."""
    found = fitted(Hemisphere())
    angle = torch.linspace(0, 2 * math.pi, 200)[:, None]
    below = torch.cat([0.5 * angle.cos(), 0.5 * angle.sin(), torch.full((200, 1), -0.25)], dim=1)
    closest = found.placed().query(below.double().numpy()).closest
    assert -closest[:, 2].mean() < 2.5 * found.surface.spacing


def test_noise_is_averaged() -> None:
    sigma = 0.004
    samples = Sphere().sample(3000)
    samples = samples + sigma * torch.randn(
        samples.shape, generator=torch.Generator().manual_seed(1)
    )
    feet = fit(SampledSurface.of(samples)).field.project(beside(Sphere(), 0.01))
    assert float(Sphere().distance(feet).square().mean().sqrt()) < 0.5 * sigma


def test_the_loss_is_equation_3(fitted_sphere: Fitted) -> None:
    """Mean over the times of the mean over the trained states, by its definition."""
    field, surface = fitted_sphere.field, fitted_sphere.surface
    schedule = TimeSchedule(5)
    finest = finest_resolution(surface.spacing, SMALL)
    losses = []
    for k, t in enumerate(schedule.times, start=1):
        grid, displacement = trajectories(surface, schedule, k, finest)
        state = grid.centres()
        foot = state - displacement
        query = foot + displacement / t
        torch.testing.assert_close(interpolate(query, foot, t), state, rtol=0, atol=1e-5)
        losses.append(float(trajectory_loss(field.velocity(state, t), query, foot)))
    assert fitted_sphere.fit.loss == pytest.approx(sum(losses) / 5, rel=1e-3)


def test_one_level_a_time_finer_and_nearer_for_smaller_times(fitted_sphere: Fitted) -> None:
    levels, times = fitted_sphere.field.levels, TimeSchedule(5).times
    assert len(levels) == 5
    finest = levels[0].grid.spacing
    for level, t in zip(levels, times, strict=True):
        assert level.grid.spacing == pytest.approx(min(finest * t / times[0], 1 / 8))
    for level in levels[:-1]:
        grid = level.grid
        assert float(Sphere().distance(grid.centres()).max()) < 1.8 * grid.spacing
    corner = torch.cartesian_prod(*3 * [torch.tensor([-1.5, 1.5])])
    assert levels[-1].covers(corner).all()


def test_every_sample_lies_in_the_finest_band(fitted_sphere: Fitted) -> None:
    finest = fitted_sphere.field.levels[0]
    assert finest.covers(fitted_sphere.surface.samples).all()
    assert finest.covers(beside(Sphere(), 0.9 * finest.grid.spacing)).all()


def test_sparse_parts_wait_for_a_coarser_level() -> None:
    """Half of a plane has fifty times fewer samples: no fine cells there, and still a plane."""
    dense, sparse = PlanePatch().sample(6000), PlanePatch().sample(120, seed=1)
    cloud = torch.cat([dense[dense[:, 0] < 0], sparse[sparse[:, 0] >= 0]])
    field = fit(SampledSurface.of(cloud), Config()).field
    centres = field.levels[0].grid.centres()
    assert float((centres[:, 0] > 0.15).float().mean()) < 0.05
    points = beside(PlanePatch(half=0.4), 0.03)
    error = ((points - field.project(points)).norm(dim=1) - PlanePatch().distance(points)).abs()
    assert float(error.mean()) < 1e-3


def resolution(spacing: float, extract: int = 256, spline: int | None = None) -> int:
    config = Config(spline=SplineConfig(spline), extract=ExtractConfig(extract))
    return finest_resolution(spacing, config)


def test_the_finest_grid_follows_the_samples() -> None:
    assert resolution(0.004) == 256  # no finer than the mesh
    assert resolution(0.004, extract=512) == 384  # cells of 0.65 spacings
    assert resolution(0.02) == 100  # cells of half a spacing where there are few samples
    assert resolution(0.02, extract=64) == 64
    assert resolution(0.5) == 16
    assert resolution(1e-6, extract=1024) == 512
    assert resolution(0.02, spline=200) == 200


def test_smoothness_is_the_one_asked_for() -> None:
    assert smoothness(SplineConfig()) == 1e-2
    assert smoothness(SplineConfig(smoothness=0.3)) == 0.3


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_any_number_of_steps(steps: int) -> None:
    surface = SampledSurface.of(Sphere().sample(800))
    config = Config(flow=FlowConfig(steps), extract=ExtractConfig(resolution=24))
    assert list(fit_spline(surface, config)) == list(range(1, steps + 1))
    field = fit(surface, config).field
    assert len(field.levels) == steps
    feet = field.project(beside(Sphere(), 0.03))
    # a single level is the coarsest, with cells of an eighth
    assert float(Sphere().distance(feet).mean()) < (2e-2 if steps == 1 else 1e-3)


def test_the_same_samples_give_the_same_bytes() -> None:
    surfaces = [SampledSurface.of(Torus().sample(800)) for _ in range(2)]
    one, two = (field_to_bytes(fit(surface).placed()) for surface in surfaces)
    assert one == two
