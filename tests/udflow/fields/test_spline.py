"""The spline energy against a slow evaluation by the definition of B-splines."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from udflow.fields.lattice import SparseLattice
from udflow.fields.spline import SplineField, SplineGrid, SplineLevel, quadratic_weights
from udflow.flow.schedule import TimeSchedule

Energy = Callable[[Tensor], Tensor]


def b_spline(x: Tensor) -> Tensor:
    """The centred quadratic B-spline by its three pieces."""
    x = x.abs()
    outer = 0.5 * (1.5 - x) ** 2
    return torch.where(x <= 0.5, 0.75 - x * x, torch.where(x <= 1.5, outer, 0.0))


def slow_energy(level: SplineLevel) -> Energy:
    """E(x) = spacing^2 sum over all nodes of c B(x) B(y) B(z), one point at a time."""
    nodes = level.grid.nodes.coordinates.double()
    coefficients = level.coefficients.double()

    def energy(point: Tensor) -> Tensor:
        local = (point - level.grid.origin.double()) / level.grid.spacing
        weight = b_spline(local - nodes).prod(dim=1)
        return level.grid.spacing**2 * (coefficients * weight).sum()

    return energy


def grid(side: int, spacing: float, keep: Callable[[Tensor], Tensor] | None = None) -> SplineGrid:
    """Cells of a cube of `side` lattice points around the origin, or those whose centres `keep`."""
    origin = torch.full((3,), -0.5 * (side - 1) * spacing)
    cells = torch.zeros(side, side, side, dtype=torch.bool)
    cells[1:-1, 1:-1, 1:-1] = True
    if keep is not None:
        centres = origin + spacing * torch.cartesian_prod(*3 * [torch.arange(side)])
        cells &= keep(centres).view(side, side, side)
    lattice = SparseLattice.from_mask(cells)
    return SplineGrid(origin, spacing, lattice, lattice.dilated(1))


def random_level(seed: int = 0) -> SplineLevel:
    """Random coefficients on a third of the cells, in double precision."""
    generator = torch.Generator().manual_seed(seed)
    chosen = grid(8, 0.1, lambda c: torch.rand(len(c), generator=generator) < 0.3)
    coefficients = torch.randn(len(chosen.nodes), generator=generator, dtype=torch.float64)
    exact = SplineGrid(chosen.origin.double(), chosen.spacing, chosen.cells, chosen.nodes)
    return SplineLevel.of(exact, coefficients)


def points_inside(level: SplineLevel, count: int = 60) -> Tensor:
    generator = torch.Generator().manual_seed(5)
    cells = level.grid.centres()
    chosen = cells[torch.randint(0, len(cells), (count,), generator=generator)]
    shift = torch.rand(chosen.shape, generator=generator, dtype=torch.float64) - 0.5
    return chosen + 0.999 * level.grid.spacing * shift


Quadratic = tuple[Tensor, Tensor]
TILTED = torch.tensor([0.6, 0.0, 0.8])


def quadratic_level(where: SplineGrid, hessian: Tensor, slope: Tensor) -> SplineLevel:
    """E(x) = x^T H x / 2 + slope x: quadratic B-splines reproduce it with the node values less
    spacing^2 trace(H) / 8."""
    nodes = where.origin + where.nodes.coordinates * where.spacing
    energy = 0.5 * ((nodes @ hessian) * nodes).sum(dim=1) + nodes @ slope
    energy = energy - where.spacing**2 * hessian.trace() / 8
    return SplineLevel.of(where, energy / where.spacing**2)


def plane_level(where: SplineGrid, normal: Tensor, offset: float = 0.0) -> SplineLevel:
    """E = (n x - offset)^2 / 2 up to a constant: the ideal energy of a plane."""
    return quadratic_level(where, torch.outer(normal, normal), -offset * normal)


def test_the_weights_are_the_b_spline_at_its_three_nodes() -> None:
    r = torch.linspace(-0.5, 0.5, 101, dtype=torch.float64).requires_grad_()
    values, slopes = quadratic_weights(r.view(1, -1))
    oracle = torch.stack([b_spline(r - node) for node in (-1, 0, 1)])
    torch.testing.assert_close(values[0], oracle)
    for found, expected in zip(slopes[0], oracle, strict=True):
        (slope,) = torch.autograd.grad(expected.sum(), r, retain_graph=True)
        torch.testing.assert_close(found, slope)


def test_the_weights_are_a_partition_of_unity() -> None:
    values, slopes = quadratic_weights(torch.linspace(-0.5, 0.5, 30).expand(3, -1))
    torch.testing.assert_close(values.sum(dim=1), torch.ones(3, 30))
    torch.testing.assert_close(slopes.sum(dim=1), torch.zeros(3, 30))


def test_the_gradient_is_that_of_the_energy() -> None:
    level = random_level()
    points = points_inside(level)
    gradient, inside = level.gradient(points)
    energy = slow_energy(level)
    expected = torch.stack([torch.autograd.functional.jacobian(energy, p) for p in points])
    assert inside.all()
    torch.testing.assert_close(gradient, expected)


def test_the_normal_gradient_is_the_hessian_times_the_gradient() -> None:
    level = random_level()
    points = points_inside(level)
    found, inside = level.normal_gradient(points)
    energy = slow_energy(level)
    hessian = torch.stack([torch.autograd.functional.hessian(energy, p) for p in points])
    gradient = torch.stack([torch.autograd.functional.jacobian(energy, p) for p in points])
    assert inside.all()
    torch.testing.assert_close(found, torch.einsum("nij,nj->ni", hessian, gradient))


def test_the_gradient_is_free_of_curl() -> None:
    """Lemma 1. Central differences inside a cell are exact for quadratic pieces."""
    level = random_level()
    cells = level.grid.centres()
    step = 0.4 * level.grid.spacing
    shifts = step * torch.eye(3, dtype=torch.float64)
    columns = [
        (level.gradient(cells + s)[0] - level.gradient(cells - s)[0]) / (2 * step) for s in shifts
    ]
    jacobian = torch.stack(columns, dim=2)
    assert float(jacobian.abs().max()) > 0.5
    torch.testing.assert_close(jacobian, jacobian.transpose(1, 2))


def test_the_gradient_is_continuous_from_cell_to_cell() -> None:
    level = plane_level(grid(6, 0.2), TILTED)
    level = SplineLevel.of(level.grid, torch.randn(216, generator=torch.Generator().manual_seed(0)))
    generator = torch.Generator().manual_seed(1)
    faces = level.grid.origin + level.grid.spacing * torch.cat(
        [torch.full((50, 1), 2.5), 1 + 3 * torch.rand(50, 2, generator=generator)], dim=1
    )
    shift = torch.tensor([1e-5, 0.0, 0.0])
    left, right = level.gradient(faces - shift)[0], level.gradient(faces + shift)[0]
    torch.testing.assert_close(left, right, rtol=0, atol=1e-3)


def test_quadratic_energies_are_reproduced() -> None:
    generator = torch.Generator().manual_seed(3)
    half = torch.randn(3, 3, generator=generator)
    hessian, slope = half + half.T, torch.randn(3, generator=generator)
    level = quadratic_level(grid(7, 0.2), hessian, slope)
    points = torch.rand(200, 3, generator=generator) - 0.5
    exact = points @ hessian + slope
    torch.testing.assert_close(level.gradient(points)[0], exact, rtol=0, atol=2e-5)
    normal = level.normal_gradient(points)[0]
    torch.testing.assert_close(normal, exact @ hessian, rtol=0, atol=1e-4)


def test_outside_its_band_a_level_says_so_and_answers_zero() -> None:
    level = plane_level(grid(9, 0.1, lambda c: c[:, 2].abs() < 0.15), TILTED)
    points = torch.tensor([[0.0, 0.0, 0.14], [0.0, 0.0, 0.16], [9.0, 0.0, 0.0], [0, 0, -9.0]])
    expected = [True, False, False, False]
    assert level.covers(points).tolist() == expected
    for answer in (level.gradient, level.normal_gradient):
        values, inside = answer(points)
        assert inside.tolist() == expected
        assert values[0].abs().max() > 0
        assert not values[1:].any()


def test_steps_by_loop_are_steps_by_tensors() -> None:
    """On cells full of holes, so that points begin outside, leave on their way, and stay."""
    exact = random_level()
    where = SplineGrid(
        exact.grid.origin.float(), exact.grid.spacing, exact.grid.cells, exact.grid.nodes
    )
    level = SplineLevel.of(where, 2.0 * exact.coefficients.float())
    points = torch.rand(3_000, 3, generator=torch.Generator().manual_seed(7)) - 0.5
    points[:3] = torch.tensor([[9.0, 0, 0], [0, -9.0, 0], [0, torch.nan, 0]])
    for steps in (1, 2):
        moved, cells = level.stepped_by_loop(points, steps)
        expected, places = level.stepped_by_tensors(points[3:], steps)
        assert (cells[:3] == -1).all()
        assert torch.equal(moved[:2], points[:2])
        assert torch.equal(cells[3:], places)
        torch.testing.assert_close(moved[3:], expected, rtol=1e-4, atol=1e-5)
        began, ended = (places >= 0).unbind(dim=1)
        assert int(began.sum()) > 150
        assert 15 < int((began & ~ended).sum()) < int(began.sum())


def layered(fine: SplineLevel, coarse: SplineLevel) -> SplineField:
    return SplineField(TimeSchedule(2), (fine, coarse))


BOX = grid(14, 0.25)
BAND = grid(40, 0.05, lambda c: (c @ TILTED).abs() < 0.1)


def test_velocity_is_the_slope_of_the_energy_over_time() -> None:
    """v(x, t) = grad E / t, by the level of t or, where that one ends, by the next."""
    field = layered(plane_level(BAND, TILTED), plane_level(BOX, TILTED, offset=0.3))
    near, far = 0.05 * TILTED, 0.7 * TILTED
    v = field.velocity(torch.stack([near, far, torch.full((3,), 9.0)]), 1 / 3)
    expected = torch.stack([3 * near, 3 * (far - 0.3 * TILTED), torch.zeros(3)])
    torch.testing.assert_close(v, expected, rtol=0, atol=2e-5)
    v = field.velocity(torch.stack([near, far]), 1.0)
    expected = torch.stack([near - 0.3 * TILTED, far - 0.3 * TILTED])
    torch.testing.assert_close(v, expected, rtol=0, atol=2e-5)


def test_between_two_times_the_later_level_answers() -> None:
    field = layered(plane_level(BAND, TILTED), plane_level(BOX, TILTED, offset=0.3))
    near = 0.05 * TILTED[None]
    torch.testing.assert_close(
        field.velocity(near, 0.5), (near - 0.3 * TILTED) / 0.5, rtol=0, atol=2e-5
    )


def test_ideal_energies_project_exactly_from_near_and_far() -> None:
    field = layered(plane_level(BAND, TILTED), plane_level(BOX, TILTED))
    generator = torch.Generator().manual_seed(4)
    points = 1.6 * torch.rand(500, 3, generator=generator) - 0.8
    exact = points - (points @ TILTED)[:, None] * TILTED
    inside = BAND.cells.find(((exact - BAND.origin) / BAND.spacing).round().long()) >= 0
    feet = field.project(points)
    torch.testing.assert_close(feet[inside], exact[inside], rtol=0, atol=2e-5)
    assert int(inside.sum()) > 300


def test_a_point_starts_at_the_smallest_time_that_covers_it() -> None:
    """Near the surface the coarse level, wrong here, is not asked; far from it, it is."""
    along = torch.tensor([0.8, 0.0, -0.6])
    wrong = quadratic_level(BOX, torch.outer(TILTED, TILTED), 0.2 * along)
    field = layered(plane_level(BAND, TILTED), wrong)
    near, far = 0.05 * TILTED, 0.3 * TILTED
    feet = field.project(torch.stack([near, far]))
    expected = torch.stack([torch.zeros(3), -2 / 3 * 0.2 * along])
    torch.testing.assert_close(feet, expected, rtol=0, atol=2e-5)


def test_the_last_step_moves_along_the_normal_alone() -> None:
    """A slope along the surface is noise of the fit: it has no place in a projection."""
    along = torch.tensor([0.8, 0.0, -0.6])
    drifting = quadratic_level(BAND, torch.outer(TILTED, TILTED), 1e-3 * along)
    field = layered(drifting, plane_level(BOX, TILTED))
    points = 0.04 * torch.tensor([1.0, 0.0, -1.0])[:, None] * TILTED
    drift = drifting.gradient(points)[0] @ along
    assert drift.tolist() == pytest.approx([1e-3] * 3, rel=0.02)
    assert float(field.project(points).norm(dim=1).max()) < 2e-5


def test_nothing_moves_outside_the_trained_box() -> None:
    field = layered(plane_level(BAND, TILTED), plane_level(BOX, TILTED))
    points = torch.tensor([[9.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
    assert torch.equal(field.project(points)[0], points[0])
    assert field.covers(points).tolist() == [False, True]
    assert field.project(points[:0]).shape == (0, 3)
