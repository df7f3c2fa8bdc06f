"""Which samples lie on no surface."""

from __future__ import annotations

import pytest
import torch
from shapes import Cube, PlanePatch, Shape, Sphere, Torus
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.outliers import without_scattered

BOX = 1.2
SHAPES = [pytest.param(s, id=type(s).__name__) for s in (Sphere(), Torus(), Cube())]


def anywhere(count: int, seed: int = 3) -> Tensor:
    """(count, 3) points evenly in a box around the shapes."""
    return BOX * (torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) - 0.5)


@pytest.mark.parametrize("share", [0.005, 0.05, 0.1])
@pytest.mark.parametrize("shape", SHAPES)
def test_samples_stay_and_what_is_far_from_them_goes(shape: Shape, share: float) -> None:
    samples, astray = shape.sample(4000), anywhere(round(4000 * share))
    kept = without_scattered(torch.cat([samples, astray]))
    assert torch.equal(kept[:4000], torch.arange(4000))
    spacing = float(NeighbourTree(samples).nearest(samples, 10).spacing.median())
    left = shape.distance(astray)[kept[4000:] - 4000]
    far = int((shape.distance(astray) > 5 * spacing).sum())
    assert int((left > 5 * spacing).sum()) <= max(2, 0.05 * far)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("shape", SHAPES)
def test_noise_is_not_scattered(shape: Shape, noise: float) -> None:
    samples = shape.sample(4000)
    samples = samples + noise * torch.randn(
        samples.shape, generator=torch.Generator().manual_seed(1)
    )
    assert len(without_scattered(samples)) == 4000


def test_a_sparse_floor_under_a_dense_thing_stays() -> None:
    floor = 4 * PlanePatch().sample(600) - torch.tensor([0.0, 0.0, 0.8])
    kept = without_scattered(torch.cat([Sphere().sample(6000), floor]))
    assert len(kept) == 6600


def test_a_floor_that_touches_a_dense_thing_loses_no_more_than_a_ring() -> None:
    floor = 4 * PlanePatch().sample(600) - torch.tensor([0.0, 0.0, 0.45])
    kept = without_scattered(torch.cat([Sphere().sample(6000), floor]))
    lost = torch.ones(6600, dtype=torch.bool)
    lost[kept] = False
    assert not lost[:6000].any()
    assert int(lost.sum()) < 25


def test_one_stray_point_goes_however_far() -> None:
    for place in (0.7, 3.0, 1e4):
        stray = torch.tensor([[0.1 * place, place, 0.0]])
        assert len(without_scattered(torch.cat([Sphere().sample(2000), stray]))) == 2000


def test_a_flat_neighbour_of_a_stray_point_stays() -> None:
    floor = 4 * PlanePatch().sample(600) - torch.tensor([0.0, 0.0, 1.5])
    stray = torch.tensor([[0.9, 0.9, -0.9]])
    kept = without_scattered(torch.cat([Sphere().sample(6000), floor, stray]))
    assert torch.equal(kept, torch.arange(6600))


@pytest.mark.parametrize("count", [1, 3, 9, 12])
def test_few_points_stay(count: int) -> None:
    assert len(without_scattered(anywhere(count))) == count


def test_where_everything_is_scattered_nothing_is_left_out() -> None:
    assert len(without_scattered(anywhere(1000))) == 1000
