"""What smoothing has flattened is given back, unless it is noise."""

from __future__ import annotations

from dataclasses import fields

import pytest
import torch
from shapes import Shape, Sphere, Torus
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.pieces import on_one_piece
from udflow.cloud.quadric_surface import QuadricSurface
from udflow.cloud.quadrics import LocalQuadrics
from udflow.cloud.sites import Sites
from udflow.cloud.twicing import nearer_to_sites
from udflow.cloud.widths import fit_quadrics


def before_and_after(shape: Shape, count: int, noise: float) -> tuple[LocalQuadrics, LocalQuadrics]:
    generator = torch.Generator().manual_seed(4)
    samples = shape.sample(count) + noise * torch.randn(count, 3, generator=generator)
    sites = Sites(samples, samples, NeighbourTree(samples))
    quadrics = on_one_piece(fit_quadrics(sites), sites)
    return quadrics, nearer_to_sites(quadrics, sites)


def error(quadrics: LocalQuadrics, shape: Shape) -> float:
    feet = QuadricSurface.of(quadrics).project(shape.sample(4_000, seed=7))
    return float(shape.distance(feet).mean())


@pytest.mark.parametrize("shape", [Sphere(), Torus()], ids=type)
def test_clean_surfaces_get_nearer(shape: Shape) -> None:
    before, after = before_and_after(shape, 1_500, 0.0)
    assert error(after, shape) < 0.95 * error(before, shape)
    only_heights = [f.name for f in fields(LocalQuadrics) if f.name != "coefficients"]
    for name in only_heights:
        assert torch.equal(getattr(before, name), getattr(after, name))
    assert torch.equal(before.coefficients[:, 1:], after.coefficients[:, 1:])


@pytest.mark.parametrize("shape", [Sphere(), Torus()], ids=type)
def test_noise_is_not_given_back(shape: Shape) -> None:
    before, after = before_and_after(shape, 4_000, 0.01)
    assert error(after, shape) < 1.03 * error(before, shape)
    moved = (after.coefficients - before.coefficients)[:, 0] * before.radius
    assert 0 < float(moved.square().mean().sqrt()) < 0.2 * 0.01


def test_what_noisy_fits_have_flattened_comes_back_in_part() -> None:
    """Bumps as wide as the neighbourhoods that the noise asks for."""
    generator = torch.Generator().manual_seed(0)
    plane = torch.rand(6_000, 2, generator=generator) - 0.5

    def height(places: Tensor) -> Tensor:
        return 0.02 * (20 * places[:, 0]).sin() * (20 * places[:, 1]).sin()

    samples = torch.cat([plane, height(plane)[:, None]], dim=1)
    samples = samples + 0.006 * torch.randn(samples.shape, generator=generator)
    sites = Sites(samples, samples, NeighbourTree(samples))
    before = on_one_piece(fit_quadrics(sites), sites)
    asked = 0.8 * (torch.rand(3_000, 2, generator=generator) - 0.5)
    places = torch.cat([asked, height(asked)[:, None]], dim=1)
    off = []
    for quadrics in (before, nearer_to_sites(before, sites)):
        feet = QuadricSurface.of(quadrics).project(places)
        off.append(float((feet[:, 2] - height(feet[:, :2])).abs().mean()))
    assert off[1] < 0.97 * off[0]
