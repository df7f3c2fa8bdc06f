"""What smoothing has flattened is given back, unless it is noise."""

from __future__ import annotations

from dataclasses import fields

import pytest
import torch
from shapes import Shape, Sphere, Torus

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


def test_noise_is_not_given_back() -> None:
    before, after = before_and_after(Torus(), 4_000, 0.01)
    assert torch.equal(before.coefficients, after.coefficients)
