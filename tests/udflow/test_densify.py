"""Densification, equation (9), along exact fields that udflow has not fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import pytest
import torch
from shapes import Hemisphere, MoebiusStrip, PlanePatch, Shape, Sphere, Torus
from torch import Tensor

from udflow.config import DensifyConfig
from udflow.densify import densified, reflow, rounds_needed
from udflow.errors import InvalidConfig
from udflow.fields.interface import ProjectiveField

CONFIG = DensifyConfig(target_points=2000, points_per_round=600)


def grown(
    cloud: Tensor,
    field: ProjectiveField,
    config: DensifyConfig = CONFIG,
    rounds: int = 1,
    seed: int = 0,
) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    samples = cloud
    for _ in range(rounds):
        samples = reflow(samples, cloud, field, config, generator)
    return samples


@pytest.mark.parametrize(
    ("points", "rounds"), [(0, 4), (199, 4), (200, 3), (1400, 1), (1999, 1), (2000, 0), (9999, 0)]
)
def test_rounds_needed(points: int, rounds: int) -> None:
    assert rounds_needed(points, CONFIG) == rounds


@pytest.mark.parametrize("shape", [Sphere(), Torus(), PlanePatch(), MoebiusStrip()], ids=type)
def test_it_reaches_the_target_in_the_rounds_it_said(shape: Shape) -> None:
    cloud = shape.sample(500)
    rounds = rounds_needed(len(cloud), CONFIG)
    sizes = [len(grown(cloud, shape, rounds=r)) for r in range(rounds + 1)]
    assert sizes == [500, 1100, 1700, 2000]


@pytest.mark.parametrize("shape", [Sphere(), Torus(), MoebiusStrip()], ids=type)
def test_new_points_lie_on_the_surface_and_the_measured_come_first(shape: Shape) -> None:
    cloud = shape.sample(500)
    points = grown(cloud, shape, rounds=3)
    assert torch.equal(points[:500], cloud)
    assert float(shape.distance(points[500:]).max()) < 1e-6
    assert len(points.unique(dim=0)) == len(points)


def test_enough_is_enough() -> None:
    cloud = Sphere().sample(2000)
    assert grown(cloud, Sphere()) is cloud


def test_nothing_is_made_up_beyond_a_rim() -> None:
    """The field is a whole sphere, the cloud its upper half: the rest was never measured."""
    cloud = Hemisphere().sample(500)
    spacing = (2 * torch.pi * 0.25 / 500) ** 0.5
    points = grown(cloud, Sphere(), rounds=3)
    assert len(points) > 1500
    below = -points[:, 2].min()
    assert 0 <= float(below) < 1.5 * spacing


def test_new_points_do_not_creep_over_a_rim_round_after_round() -> None:
    cloud = Hemisphere().sample(500)
    spacing = (2 * torch.pi * 0.25 / 500) ** 0.5
    config = DensifyConfig(target_points=4000, points_per_round=100)
    points = grown(cloud, Sphere(), config, rounds=12)
    assert -float(points[:, 2].min()) < 1.5 * spacing


def test_what_was_made_up_before_is_no_evidence() -> None:
    """Points of an earlier round that went astray attract no others."""
    cloud = Hemisphere().sample(500)
    astray = Sphere().sample(600, seed=1)
    samples = torch.cat([cloud, astray[astray[:, 2] < -0.1]])
    points = reflow(samples, cloud, Sphere(), CONFIG, torch.Generator().manual_seed(0))
    assert len(points) > len(samples) + 100
    assert float(points[len(samples) :, 2].min()) > -0.1


@dataclass(frozen=True)
class Lazy:
    """A field that goes only part of the way."""

    shape: Shape
    part: float

    def project(self, points: Tensor) -> Tensor:
        return points + self.part * (self.shape.closest(points) - points)


def test_only_points_below_the_threshold_are_kept() -> None:
    """This field puts a foot at 60 % of its distance; the threshold is on what the field says."""
    cloud = Sphere().sample(500)
    config = DensifyConfig(target_points=2000, points_per_round=1500, threshold=0.002)
    wide = DensifyConfig(target_points=2000, points_per_round=1500, threshold=0.1)
    field = Lazy(Sphere(), 0.6)
    strict, lax = (Sphere().distance(grown(cloud, field, c)[500:]) for c in (config, wide))
    assert 0.6 * float(strict.max()) < 0.002 + 1e-6
    assert 0.6 * float(lax.max()) > 0.005
    assert 100 < len(strict) < len(lax)


def test_a_field_without_a_surface_adds_nothing() -> None:
    class Adrift:
        def project(self, points: Tensor) -> Tensor:
            return points + 0.02

    cloud = Sphere().sample(500)
    assert torch.equal(grown(cloud, Adrift()), cloud)


def test_it_repeats_with_the_generator() -> None:
    cloud = Torus().sample(500)
    one, two = grown(cloud, Torus(), rounds=2), grown(cloud, Torus(), rounds=2)
    assert torch.equal(one, two)
    assert not torch.equal(one, grown(cloud, Torus(), rounds=2, seed=1))


def test_most_points_are_added_where_samples_are_sparse() -> None:
    left = PlanePatch().sample(900)
    right = PlanePatch().sample(100, seed=1)
    cloud = torch.cat([left[left[:, 0] < 0], right[right[:, 0] >= 0]])
    points = grown(cloud, PlanePatch(), rounds=2)

    def share(of: Tensor) -> float:
        return float((of[:, 0] >= 0).float().mean())

    assert share(cloud) < 0.15
    assert share(points[len(cloud) :]) > 0.3


class OnlyDistances:
    """A field of somebody else: distances and gradients, no way of its own to the surface."""

    def __init__(self, shape: Shape, length: float = 1.0) -> None:
        self.shape, self.length = shape, length

    def distance(self, points: Tensor) -> Tensor:
        return self.shape.distance(points)

    def gradient(self, points: Tensor) -> Tensor:
        return self.length * (points - self.shape.closest(points))


@pytest.mark.parametrize("length", [1.0, 7.0])
def test_any_object_with_distance_and_gradient_will_do(length: float) -> None:
    cloud = Torus().sample(500)
    points = grown(cloud, OnlyDistances(Torus(), length), rounds=3)
    assert len(points) == 2000
    assert float(Torus().distance(points).max()) < 1e-5


def test_an_object_that_is_no_field_is_refused() -> None:
    with pytest.raises(TypeError, match=r"needs project\(points\), or distance\(points\) and"):
        grown(Sphere().sample(500), object())  # type: ignore[arg-type]


def test_every_round_is_there_with_its_counters() -> None:
    cloud = Sphere().sample(500)
    config = DensifyConfig(target_points=1500, points_per_round=400)
    fitted_to: list[int] = []

    def fit(samples: Tensor) -> ProjectiveField:
        fitted_to.append(len(samples))
        return Sphere()

    rounds = list(densified(cloud, fit, config, torch.Generator().manual_seed(0)))
    assert [r.number for r in rounds] == [0, 1, 2, 3]
    assert [len(r.samples) for r in rounds] == [500, 900, 1300, 1500]
    assert fitted_to == [500, 900, 1300]
    for before, after in pairwise(rounds):
        assert torch.equal(after.samples[: len(before.samples)], before.samples)
        assert after.added == len(after.samples) - len(before.samples)
        assert after.candidates >= after.near >= after.supported >= after.added
    assert rounds[1].counts()["points"] == 900


def test_without_a_guard_epsilon_alone_decides() -> None:
    cloud = Hemisphere().sample(500)
    config = DensifyConfig(target_points=4000, points_per_round=500, guard="none")
    points = grown(cloud, Sphere(), config, rounds=6)
    guarded = grown(cloud, Sphere(), replace(config, guard="support"), rounds=6)
    assert float(points[:, 2].min()) < 2 * float(guarded[:, 2].min())


class Uncertain:
    """A field whose feet are right in the upper half only; below it never arrives."""

    def project(self, points: Tensor) -> Tensor:
        sliding = points + torch.tensor([0.03, 0.0, 0.0])
        return torch.where(points[:, 2:] > 0, Sphere().closest(points), sliding)


def test_epsilon_keeps_out_what_the_field_itself_doubts() -> None:
    cloud = Sphere().sample(500)
    config = DensifyConfig(target_points=900, points_per_round=400, guard="none")
    strict = grown(cloud, Uncertain(), config)[500:]
    off = grown(cloud, Uncertain(), replace(config, threshold=None))[500:]
    assert float(Sphere().distance(strict).max()) < 1e-5
    assert float(Sphere().distance(off).max()) > 0.01


def test_a_target_below_the_cloud_is_refused() -> None:
    cloud = Sphere().sample(500)
    config = DensifyConfig(target_points=400)
    rounds = densified(cloud, lambda samples: Sphere(), config, torch.Generator())
    with pytest.raises(InvalidConfig, match=r"400, fewer than the 500 points .* raise it"):
        next(rounds)
