"""Local quadrics: what they recover exactly, how wide they grow, what they say about noise."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from shapes import PlanePatch, Sphere, Torus, TwoSheets
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadrics import LocalQuadrics, feet_on_quadrics, joined, principal_frame
from udflow.cloud.sites import Sites
from udflow.cloud.widths import NEIGHBOUR_COUNTS, fit_quadrics


def noisy(points: Tensor, sigma: float) -> Tensor:
    generator = torch.Generator().manual_seed(7)
    return points + sigma * torch.randn(points.shape, generator=generator)


def fitted(samples: Tensor) -> LocalQuadrics:
    return fit_quadrics(Sites(samples, samples, NeighbourTree(samples)))


def curvatures(quadrics: LocalQuadrics) -> Tensor:
    """(n, 2) second derivatives along u and v, in units of the cloud."""
    return 2 * quadrics.coefficients[:, [3, 5]] / quadrics.radius[:, None]


def test_the_curvature_of_a_sphere_is_recovered() -> None:
    """Radius 1/2: both curvatures are 2, on the side of the centre."""
    quadrics = fitted(Sphere().sample(3000))
    inward = -torch.sign((quadrics.frame[:, 2] * quadrics.origin).sum(dim=1))
    found = curvatures(quadrics) * inward[:, None]
    assert float(found.median()) == pytest.approx(2.0, rel=0.05)
    assert float((found - 2).abs().median()) < 0.15


def test_the_normal_is_found_whatever_its_sign() -> None:
    quadrics = fitted(Torus().sample(3000))
    core = 0.35 * torch.nn.functional.normalize(quadrics.origin[:, :2], dim=1)
    normal = quadrics.origin - torch.cat([core, torch.zeros(3000, 1)], dim=1)
    cosine = torch.nn.functional.cosine_similarity(quadrics.frame[:, 2], normal).abs()
    assert float(cosine.quantile(0.05)) > 0.98
    identity = quadrics.frame @ quadrics.frame.transpose(1, 2)
    torch.testing.assert_close(identity, torch.eye(3).expand(3000, 3, 3), rtol=0, atol=1e-5)


def test_a_plane_is_exact() -> None:
    quadrics = fitted(PlanePatch().sample(2000))
    generator = torch.Generator().manual_seed(1)
    queries = quadrics.origin + 0.005 * torch.randn(2000, 3, generator=generator)
    feet = feet_on_quadrics(quadrics, queries)
    expected = queries * torch.tensor([1.0, 1.0, 0.0])
    torch.testing.assert_close(feet, expected, rtol=0, atol=1e-6)
    assert float(quadrics.error.max()) < 1e-6
    assert float(curvatures(quadrics).abs().max()) < 1e-3
    assert set(quadrics.count.tolist()) == {NEIGHBOUR_COUNTS[0]}


@pytest.mark.parametrize("shape", [PlanePatch(), Sphere()], ids=type)
@pytest.mark.parametrize("sigma", [0.002, 0.005, 0.01])
def test_the_held_back_error_is_the_noise(shape: PlanePatch | Sphere, sigma: float) -> None:
    quadrics = fitted(noisy(shape.sample(3000), sigma))
    assert float(quadrics.error.median()) == pytest.approx(sigma, rel=0.3)


def test_widths_grow_with_the_noise() -> None:
    clean = Sphere().sample(3000)
    counts = [
        float(fitted(noisy(clean, sigma)).count.float().mean()) for sigma in (0.0, 0.001, 0.004)
    ]
    assert counts[0] < 14
    assert counts[0] < counts[1] < counts[2]
    assert counts[2] > 48
    assert set(fitted(noisy(clean, 0.004)).count.tolist()) <= set(NEIGHBOUR_COUNTS)


def test_wide_quadrics_average_the_noise_away() -> None:
    sigma = 0.004
    samples = noisy(Sphere().sample(3000), sigma)
    feet = feet_on_quadrics(fitted(samples), samples)
    assert float(Sphere().distance(feet).square().mean().sqrt()) < 0.45 * sigma


def test_noise_as_large_as_the_spacing_is_seen_and_averaged_away() -> None:
    """Ten neighbours fill a ball then, and what they miss by is a share of its radius."""
    spacing = math.sqrt(math.pi / 20_000)
    samples = noisy(Sphere().sample(20_000), spacing)
    quadrics = fitted(samples)
    assert float(quadrics.error.median()) == pytest.approx(spacing, rel=0.25)
    feet = feet_on_quadrics(quadrics, samples)
    assert float(Sphere().distance(feet).square().mean().sqrt()) < 0.45 * spacing


def test_two_sheets_are_no_noise() -> None:
    """A gap of 1.2 spacings and a little noise: averaged, both would be one in the middle."""
    sheets = TwoSheets(gap=1.2 * math.sqrt(2 / 6000))
    inside = TwoSheets(gap=sheets.gap, half=0.4)
    quadrics = fitted(noisy(sheets.sample(6000), 0.1 * sheets.gap))
    within = inside.distance(quadrics.origin) < sheets.gap
    assert float((quadrics.count[within] <= 24).float().mean()) > 0.9


def test_spacing_is_that_of_the_samples() -> None:
    for count in (1000, 4000):
        spacing = fitted(Sphere().sample(count)).spacing.median()
        assert float(spacing) == pytest.approx(math.sqrt(math.pi / count), rel=0.1)


def saddle(count: int) -> LocalQuadrics:
    """Copies of one bent and tilted quadric, w = 0.05 + 0.1 u - 0.2 v + u^2 / 2 - 0.1 uv - v^2 / 4
    in an oblique frame, of radius 0.2."""
    axes = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(4)))[0]
    coefficients = torch.tensor([0.05, 0.1, -0.2, 0.5, -0.1, -0.25])
    one = torch.ones(count)
    return LocalQuadrics(
        origin=torch.tensor([0.3, -0.1, 0.2]).expand(count, 3),
        frame=axes.expand(count, 3, 3),
        coefficients=coefficients.expand(count, 6),
        radius=0.2 * one,
        error=0 * one,
        spacing=0.1 * one,
        count=torch.full((count,), 10),
    )


def test_feet_are_the_nearest_points_of_the_quadric() -> None:
    generator = torch.Generator().manual_seed(5)
    quadrics = saddle(100)
    queries = quadrics.origin + 0.08 * torch.randn(100, 3, generator=generator)
    u, v = torch.meshgrid(2 * [torch.linspace(-2, 2, 801)], indexing="ij")
    c = quadrics.coefficients[0]
    w = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    patch = torch.stack([u, v, w], dim=-1).view(-1, 3) @ quadrics.frame[0] * 0.2
    nearest = torch.cdist(queries - quadrics.origin, patch).min(dim=1).values

    found = feet_on_quadrics(quadrics, queries, newton_steps=8)
    torch.testing.assert_close((queries - found).norm(dim=1), nearest, rtol=0, atol=1e-4)
    quick = feet_on_quadrics(quadrics, queries)
    assert float(((queries - quick).norm(dim=1) - nearest).mean()) < 1e-3


def test_feet_are_on_the_quadric_and_finite_even_beyond_its_focus() -> None:
    generator = torch.Generator().manual_seed(6)
    quadrics = saddle(500)
    queries = quadrics.origin + 2.0 * torch.randn(500, 3, generator=generator)
    local = torch.einsum(
        "nij,nj->ni", quadrics.frame, (feet_on_quadrics(quadrics, queries) - quadrics.origin) / 0.2
    )
    assert float(local[:, :2].abs().max()) <= 2.0 + 1e-5
    u, v, w = local.unbind(dim=1)
    c = quadrics.coefficients[0]
    height = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    torch.testing.assert_close(w, height, rtol=0, atol=1e-4)


def test_only_the_sites_get_quadrics_and_all_samples_are_data() -> None:
    samples = noisy(Sphere().sample(3000), 0.003)
    tree = NeighbourTree(samples)
    every = fit_quadrics(Sites(samples, samples, tree))
    some = fit_quadrics(Sites(samples[::3], samples, tree))
    assert torch.equal(some.origin, samples[::3])
    assert float(some.error.median()) == pytest.approx(float(every.error.median()), rel=0.1)
    torch.testing.assert_close(some.spacing.median(), every.spacing.median(), rtol=0.1, atol=0)


def test_choosing_and_joining() -> None:
    quadrics = fitted(Sphere().sample(200))
    both = joined([quadrics[torch.arange(50)], quadrics[torch.arange(50, 200)]])
    for field in dataclasses.fields(LocalQuadrics):
        assert torch.equal(getattr(both, field.name), getattr(quadrics, field.name))


@pytest.mark.parametrize("count", [1, 3, 7])
def test_few_samples_give_finite_quadrics(count: int) -> None:
    quadrics = fitted(Sphere().sample(count))
    feet = feet_on_quadrics(quadrics, quadrics.origin + 0.1)
    assert torch.isfinite(feet).all()
    assert torch.isfinite(quadrics.error).all()


def test_samples_in_a_line_give_finite_quadrics() -> None:
    line = torch.linspace(-0.5, 0.5, 200)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    quadrics = fitted(line)
    assert torch.isfinite(feet_on_quadrics(quadrics, line + 0.01)).all()


def test_the_frame_runs_from_wide_to_narrow() -> None:
    generator = torch.Generator().manual_seed(2)
    axes = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    spread = torch.tensor([3.0, 1.0, 0.1])
    offsets = (torch.randn(1, 500, 3, generator=generator) * spread) @ axes * 1e-4
    frame = principal_frame(offsets, torch.ones(1, 500))[0]
    agreement = (frame @ axes.T).abs()
    torch.testing.assert_close(agreement, torch.eye(3), rtol=0, atol=0.1)
