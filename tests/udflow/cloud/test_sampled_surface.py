"""The surface that samples describe, as a field of its own."""

from __future__ import annotations

import math

import pytest
import torch
from shapes import Hemisphere, MoebiusStrip, PlanePatch, Shape, Sphere, Torus, TwoSheets
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface, thinned


def beside(shape: Shape, reach: float, count: int = 2000) -> Tensor:
    """Points up to about `reach` from the surface."""
    generator = torch.Generator().manual_seed(3)
    return shape.sample(count, seed=9) + reach / 3 * torch.randn(count, 3, generator=generator)


@pytest.mark.parametrize(
    ("shape", "inner", "tolerance"),
    [
        (Sphere(), Sphere(), 1e-4),
        (Torus(), Torus(), 4e-4),
        (PlanePatch(), PlanePatch(half=0.42), 1e-6),
        (MoebiusStrip(), MoebiusStrip(half=0.08), 1e-4),
    ],
    ids=lambda value: type(value).__name__,
)
def test_feet_lie_on_the_surface(shape: Shape, inner: Shape, tolerance: float) -> None:
    surface = SampledSurface.of(shape.sample(2500))
    feet = surface.project(beside(inner, 0.04))
    assert float(shape.distance(feet).mean()) < tolerance


def test_far_away_feet_are_still_on_the_surface() -> None:
    surface = SampledSurface.of(Sphere().sample(2500))
    generator = torch.Generator().manual_seed(4)
    points = 4 * (torch.rand(2000, 3, generator=generator) - 0.5)
    distance = (points - surface.project(points)).norm(dim=1)
    torch.testing.assert_close(distance, Sphere().distance(points), rtol=0, atol=4e-3)


def test_another_sheet_does_not_pull() -> None:
    """Sheets two and a half sample spacings apart."""
    shape = TwoSheets(gap=0.06)
    surface = SampledSurface.of(shape.sample(4000))
    inner = TwoSheets(gap=0.06, half=0.42)
    feet = surface.project(beside(inner, 0.01))
    assert float(shape.distance(feet).mean()) < 5e-4


def test_where_a_sheet_has_few_samples_the_other_does_not_answer_for_it() -> None:
    """Most of the nearest samples are on the farther sheet: over a bare spot two spacings
    wide, of two sheets one and a quarter apart."""
    samples = TwoSheets(gap=0.035).sample(2500)
    bare = (samples[:, 2] > 0) & (samples[:, :2].norm(dim=1) < 0.03)
    surface = SampledSurface.of(samples[~bare])
    angle = torch.linspace(0, 2 * math.pi, 50)
    under = torch.stack([0.01 * angle.cos(), 0.01 * angle.sin(), torch.full((50,), 0.01)], dim=1)
    feet = surface.project(under)
    assert float((feet[:, 2] - 0.0175).abs().max()) < 0.004


def test_quadrics_end_where_their_data_end() -> None:
    """Beyond the rim of a hemisphere the feet stay within a few spacings of it, however far the
    queries are."""
    surface = SampledSurface.of(Hemisphere().sample(2000))
    angle = torch.linspace(0, 2 * math.pi, 200)[:, None]
    ring = 0.5 * torch.cat([angle.cos(), angle.sin(), torch.zeros(200, 1)], dim=1)
    for depth in (0.1, 0.3):
        feet = surface.project(ring - torch.tensor([0.0, 0.0, depth]))
        assert float(-feet[:, 2].mean()) < 2.5 * surface.spacing
        assert float(-feet[:, 2].min()) < 4 * surface.spacing


def test_spacing_and_error_are_lengths() -> None:
    surface = SampledSurface.of(PlanePatch().sample(2500))
    assert surface.spacing == pytest.approx(1 / 50, rel=0.1)
    assert surface.error < 1e-6
    shaken = beside(PlanePatch(), 0.012)
    assert SampledSurface.of(shaken).error == pytest.approx(0.004, rel=0.3)


def test_detail_that_is_not_asked_for_costs_no_quadrics() -> None:
    samples = Sphere().sample(6000)
    surface = SampledSurface.of(samples, detail=0.03)
    assert len(surface.surface.quadrics.origin) < 3500
    assert len(surface.samples) == 6000
    assert float(surface.surface.quadrics.spacing.min()) > 0.0299
    feet = surface.project(beside(Sphere(), 0.04))
    assert float(Sphere().distance(feet).mean()) < 1e-4


def test_thinning_keeps_the_first_of_every_cell_in_order() -> None:
    points = torch.tensor([[0.9, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [-0.1, 0, 0], [0.6, 0, 0]])
    assert torch.equal(thinned(points, 0.5), points[[0, 1, 3]])


def test_no_points_no_feet() -> None:
    surface = SampledSurface.of(Sphere().sample(200))
    assert surface.project(torch.empty(0, 3)).shape == (0, 3)


def test_it_repeats_itself() -> None:
    one, two = (SampledSurface.of(Torus().sample(800)) for _ in range(2))
    queries = beside(Torus(), 0.05)
    assert torch.equal(one.project(queries), two.project(queries))
