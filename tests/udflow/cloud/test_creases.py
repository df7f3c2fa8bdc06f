"""Creases, corners and thin walls: quadrics keep to one piece, and feet end where pieces meet."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.pieces import on_one_piece
from udflow.cloud.quadric_surface import QuadricSurface
from udflow.cloud.sampled_surface import SampledSurface
from udflow.cloud.sites import Sites
from udflow.cloud.widths import fit_quadrics

SPACING = 0.02


def uniform(count: int, seed: int) -> Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) - 0.5


def cube(count: int = 15_000, seed: int = 3) -> Tensor:
    """Random points on the faces of the cube with corners at +-0.5."""
    points = uniform(count, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    axis = torch.randint(0, 3, (count,), generator=generator)
    side = torch.randint(0, 2, (count,), generator=generator) - 0.5
    points[torch.arange(count), axis] = side
    return points


def foot_on_cube(queries: Tensor) -> Tensor:
    """The nearest points of the cube's surface, exactly."""
    clamped = queries.clamp(-0.5, 0.5)
    inside = (queries.abs() < 0.5).all(dim=1)
    axis = queries.abs().argmax(dim=1)
    row = torch.arange(len(queries))
    pushed = clamped.clone()
    pushed[row, axis] = 0.5 * torch.sign(queries[row, axis])
    return torch.where(inside[:, None], pushed, clamped)


def near_edges(count: int, outside: bool) -> Tensor:
    """Queries within a spacing of the edge x = y = 0.5, away from its ends."""
    generator = torch.Generator().manual_seed(5)
    offset = SPACING * torch.rand(count, 2, generator=generator)
    along = 0.8 * torch.rand(count, 1, generator=generator) - 0.4
    return torch.cat([0.5 + (offset if outside else -offset), along], dim=1)


def plain(samples: Tensor) -> QuadricSurface:
    """The surface with quadrics through all the nearest samples, whatever they belong to."""
    return QuadricSurface.of(fit_quadrics(Sites(samples, samples, NeighbourTree(samples))))


@pytest.mark.parametrize("outside", [True, False])
def test_feet_at_an_edge_are_those_of_the_cube(outside: bool) -> None:
    surface = SampledSurface.of(cube())
    queries = near_edges(2000, outside)
    error = (surface.project(queries) - foot_on_cube(queries)).norm(dim=1)
    without = (plain(cube()).project(queries) - foot_on_cube(queries)).norm(dim=1)
    assert float(error.median()) < 0.01 * SPACING
    assert float(error.mean()) < 0.15 * SPACING
    assert float(error.mean()) < 0.6 * float(without.mean())


def test_feet_of_what_lies_outside_a_corner_are_at_the_corner() -> None:
    surface = SampledSurface.of(cube())
    corners = torch.tensor([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5
    queries = corners * (1 + 0.5 * SPACING)
    assert float((surface.project(queries) - corners).norm(dim=1).max()) < SPACING


def test_a_smooth_surface_has_one_piece_everywhere() -> None:
    points = torch.nn.functional.normalize(uniform(6000, 2), dim=1) * 0.5
    sites = Sites(points, points, NeighbourTree(points))
    quadrics = fit_quadrics(sites)
    kept = on_one_piece(quadrics, sites)
    changed = (kept.coefficients != quadrics.coefficients).any(dim=1)
    assert float(changed.float().mean()) < 0.01


def test_noise_is_not_taken_for_creases() -> None:
    points = torch.nn.functional.normalize(uniform(6000, 2), dim=1) * 0.5
    points += 0.004 * torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
    sites = Sites(points, points, NeighbourTree(points))
    quadrics = fit_quadrics(sites)
    changed = on_one_piece(quadrics, sites).coefficients != quadrics.coefficients
    assert float(changed.any(dim=1).float().mean()) < 0.02


def test_the_sides_of_a_thin_wall_keep_apart() -> None:
    points = uniform(20_000, 4)
    gap = 0.015  # twice the spacing
    points[:, 2] = torch.where(torch.arange(len(points)) % 2 == 0, 0.5 * gap, -0.5 * gap)
    surface = SampledSurface.of(points)
    inner = uniform(2000, 6) * 0.8
    side = torch.where(torch.arange(len(inner)) % 2 == 0, 0.5 * gap, -0.5 * gap)
    inner[:, 2] = 1.4 * side
    off = (surface.project(inner)[:, 2] - side).abs()
    before = (plain(points).project(inner)[:, 2] - side).abs()
    assert float(off.mean()) < 0.05 * gap
    assert float(off.mean()) < float(before.mean())


def test_a_sheet_that_goes_on_beyond_a_junction_is_not_cut() -> None:
    floor = uniform(12_000, 7)
    floor[:, 2] = 0.0
    wall = uniform(6000, 8)
    wall[:, 0], wall[:, 2] = 0.0, wall[:, 2].abs()
    surface = SampledSurface.of(torch.cat([floor, wall]))
    below = uniform(2000, 9) * torch.tensor([0.04, 0.8, 0.0]) - torch.tensor([0.0, 0.0, 0.004])
    exact = below * torch.tensor([1.0, 1.0, 0.0])
    error = (surface.project(below) - exact).norm(dim=1)
    assert float(error.median()) < 1e-4
    assert float(error.mean()) < 1e-3
