"""The exact shapes that other tests rely on are themselves checked against brute force."""

import pytest
import torch
from shapes import ALL_SHAPES, MoebiusStrip, Shape

NAMES = [type(shape).__name__ for shape in ALL_SHAPES]


@pytest.fixture(params=ALL_SHAPES, ids=NAMES)
def shape(request: pytest.FixtureRequest) -> Shape:
    return request.param


def test_samples_lie_on_the_surface(shape: Shape) -> None:
    points = shape.sample(2000, seed=1)
    assert points.shape == (2000, 3)
    assert shape.distance(points.double()).max() < 1e-7


def test_samples_repeat_with_the_seed(shape: Shape) -> None:
    assert torch.equal(shape.sample(100, seed=3), shape.sample(100, seed=3))
    assert not torch.equal(shape.sample(100, seed=3), shape.sample(100, seed=4))


def test_no_sample_is_nearer_than_the_closest_point(shape: Shape) -> None:
    generator = torch.Generator().manual_seed(2)
    queries = 1.4 * (torch.rand((500, 3), generator=generator, dtype=torch.float64) - 0.5)
    brute = torch.cdist(queries, shape.sample(40_000, seed=5).double()).min(dim=1).values
    exact = shape.distance(queries)
    assert (exact <= brute + 1e-6).all()
    assert (brute - exact).mean() < 0.004
    assert shape.distance(shape.closest(queries)).max() < 1e-6


def test_samples_are_uniform_by_area() -> None:
    strip = MoebiusStrip()
    x = strip.sample(40_000).double()[:, 0]
    u = 2 * torch.pi * (torch.arange(4000, dtype=torch.float64) + 0.5) / 4000
    v = strip.half * (2 * (torch.arange(200, dtype=torch.float64) + 0.5) / 200 - 1)
    u, v = (t.reshape(-1) for t in torch.meshgrid(u, v, indexing="ij"))
    weight = torch.sqrt((strip.ring + v * (u / 2).cos()) ** 2 + v**2 / 4)
    expected = (strip._at(u, v)[:, 0] * weight).sum() / weight.sum()
    assert abs(x.mean() - expected) < 4 * x.std() / 200
