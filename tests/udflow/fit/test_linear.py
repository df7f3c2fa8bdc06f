"""The linear solve against a dense least-squares solver that knows only the definition."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from udflow.errors import Diverged
from udflow.fields.lattice import SparseLattice
from udflow.fields.spline import SplineGrid
from udflow.fit import linear
from udflow.fit.linear import solve_level

Array = NDArray[np.float64]
SPACING = 0.1
VALUE_WEIGHT = 0.05


def grid(side: int = 4, keep: float = 1.0, seed: int = 0) -> SplineGrid:
    """A cube of cells around the origin, or a random part of it."""
    mask = torch.zeros(side + 2, side + 2, side + 2, dtype=torch.bool)
    generator = torch.Generator().manual_seed(seed)
    mask[1:-1, 1:-1, 1:-1] = torch.rand(side, side, side, generator=generator) < keep
    cells = SparseLattice.from_mask(mask)
    origin = torch.full((3,), -0.5 * (side + 1) * SPACING)
    return SplineGrid(origin, SPACING, cells, cells.dilated(1))


def b_spline(x: Array) -> Array:
    x = np.abs(x)
    return np.where(x <= 0.5, 0.75 - x * x, np.where(x <= 1.5, 0.5 * (1.5 - x) ** 2, 0.0))


def b_slope(x: Array) -> Array:
    return np.where(np.abs(x) <= 0.5, -2 * x, np.where(np.abs(x) <= 1.5, x - 1.5 * np.sign(x), 0.0))


@dataclass(frozen=True)
class Dense:
    """The least-squares problem as matrices, in cells: what `solve_level` never writes down."""

    slopes: Array
    values: Array
    differences: Array

    @classmethod
    def of(cls, grid: SplineGrid) -> Dense:
        nodes = grid.nodes.coordinates.numpy().astype(np.float64)
        offset = grid.cells.coordinates.numpy()[:, None] - nodes[None]
        b, d = b_spline(offset), b_slope(offset)
        slopes = [d[..., 0] * b[..., 1] * b[..., 2], b[..., 0] * d[..., 1] * b[..., 2]]
        slopes.append(b[..., 0] * b[..., 1] * d[..., 2])
        return cls(np.stack(slopes, axis=1), b.prod(axis=2), _third_differences(grid))

    def solve(self, displacement: Array, smoothness: float) -> Array:
        """The minimiser, by a singular value decomposition."""
        weight = math.sqrt(VALUE_WEIGHT)
        energy = 0.5 * (displacement**2).sum(axis=1)
        nodes = self.values.shape[1]
        matrix = [self.slopes.reshape(-1, nodes), weight * self.values]
        matrix.append(math.sqrt(smoothness) * self.differences)
        right = [displacement.ravel(), weight * energy, np.zeros(len(self.differences))]
        return np.linalg.lstsq(np.concatenate(matrix), np.concatenate(right), rcond=None)[0]

    def gradient(self, coefficients: Array) -> Array:
        return self.slopes @ coefficients


def _third_differences(grid: SplineGrid) -> Array:
    """One row for every four active nodes in a line."""
    number = {tuple(p): i for i, p in enumerate(grid.nodes.coordinates.tolist())}
    rows = []
    for point in number:
        for axis in range(3):
            line = [tuple(np.add(point, i * np.eye(3, dtype=int)[axis])) for i in range(4)]
            if all(p in number for p in line):
                row = np.zeros(len(number))
                row[[number[p] for p in line]] = (-1, 3, -3, 1)
                rows.append(row)
    return np.array(rows)


def displacement_from_sphere(grid: SplineGrid, radius: float = 0.25) -> Tensor:
    centres = grid.centres() + torch.tensor([0.1, 0.02, 0.3])
    return centres * (1 - radius / centres.norm(dim=1, keepdim=True))


@pytest.mark.parametrize("smoothness", [1e-2, 1.0])
@pytest.mark.parametrize("keep", [1.0, 0.4], ids=["full", "sparse"])
def test_it_tends_to_the_dense_solution(
    smoothness: float, keep: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(linear, "_ITERATIONS", 400)
    monkeypatch.setattr(linear, "_MOST_ITERATIONS", 400)
    monkeypatch.setattr(linear, "_TOLERANCE", 1e-7)
    where = grid(keep=keep)
    displacement = displacement_from_sphere(where)
    generator = torch.Generator().manual_seed(1)
    displacement = displacement + 0.01 * torch.randn(displacement.shape, generator=generator)
    fit = solve_level(where, displacement, smoothness)

    dense = Dense.of(where)
    exact = dense.solve(displacement.numpy() / SPACING, smoothness)
    found = fit.level.coefficients.numpy()
    np.testing.assert_allclose(dense.gradient(found), dense.gradient(exact), atol=2e-3)
    np.testing.assert_allclose(dense.values @ found, dense.values @ exact, atol=5e-3)
    misfit = dense.gradient(found) - displacement.numpy() / SPACING
    assert fit.residual == pytest.approx((misfit**2).sum(axis=1).mean() * SPACING**2, rel=1e-3)


@pytest.mark.parametrize("keep", [1.0, 0.4], ids=["full", "sparse"])
def test_products_by_loop_are_products_by_tensors(keep: float) -> None:
    where = grid(side=8, keep=keep)
    system = linear._NormalSystem.of(where, displacement_from_sphere(where), 0.3)
    coefficients = torch.randn(system.nodes, generator=torch.Generator().manual_seed(4))
    expected = system.product_by_tensors(coefficients)
    found = system.product_by_loop(coefficients)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


def test_few_iterations_are_enough() -> None:
    """The solve stops early; what it then misses is small beside what a spline cannot resolve."""
    where = grid(side=6)
    displacement = displacement_from_sphere(where)
    fit = solve_level(where, displacement, 1e-2)
    dense = Dense.of(where)
    exact = dense.gradient(dense.solve(displacement.numpy() / SPACING, 1e-2)) * SPACING
    missed = fit.level.gradient(where.centres())[0].numpy() - exact
    unresolved = exact - displacement.numpy()
    assert np.sqrt((missed**2).mean()) < 0.5 * np.sqrt((unresolved**2).mean())
    assert fit.iterations > 0


def plane_displacement(where: SplineGrid) -> Tensor:
    normal = torch.tensor([0.6, 0.0, 0.8])
    return (where.centres() @ normal - 0.03)[:, None] * normal


@pytest.mark.parametrize("smoothness", [1e-2, 0.1, 1.0])
def test_smoothness_leaves_planes_alone(smoothness: float) -> None:
    where = grid(side=6)
    displacement = plane_displacement(where)
    fit = solve_level(where, displacement, smoothness)
    error = (fit.level.gradient(where.centres())[0] - displacement).norm(dim=1)
    assert float(error.mean()) < 0.02 * float(displacement.norm(dim=1).mean())


def test_smoothness_flattens_what_bends() -> None:
    """A kink half way between two sheets is a third difference, and is rounded."""
    where = grid(side=6)
    z = where.centres()[:, 2]
    displacement = torch.zeros(len(z), 3)
    displacement[:, 2] = z - 0.2 * z.sign()
    residuals = [solve_level(where, displacement, s).residual for s in (1e-3, 1e-1, 10.0)]
    assert residuals == sorted(residuals)
    assert residuals[2] > 1.5 * residuals[0]


def test_scale_changes_nothing() -> None:
    small = grid()
    large = SplineGrid(small.origin * 4, small.spacing * 4, small.cells, small.nodes)
    one = solve_level(small, displacement_from_sphere(small), 1e-2)
    two = solve_level(large, 4 * displacement_from_sphere(small), 1e-2)
    torch.testing.assert_close(one.level.coefficients, two.level.coefficients)
    assert two.residual == pytest.approx(16 * one.residual, rel=1e-4)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_targets_that_are_not_finite_are_refused_in_words(bad: float) -> None:
    where = grid()
    displacement = displacement_from_sphere(where)
    displacement[5, 1] = bad
    with pytest.raises(Diverged, match="targets of the fit are not finite; check the cloud"):
        solve_level(where, displacement, 1e-2)


def test_a_solution_that_overflows_is_noticed() -> None:
    where = grid()
    with pytest.raises(Diverged, match=r"choose a larger spline\.smoothness"):
        solve_level(where, torch.full((len(where.cells), 3), 1e30), 1e-2)


def test_cells_where_the_surface_jumps_are_not_faithful() -> None:
    """Feet on one of two planes, whichever is nearer: between them no smooth energy follows."""
    where = grid(side=12)
    x = where.centres()[:, :1]
    nearest = torch.where(x > 0, 2.0, -2.0) * SPACING
    displacement = torch.cat([x - nearest, torch.zeros(len(x), 2)], dim=1)
    level = solve_level(where, displacement, 1e-2, noise=1e-4).level
    between = x[:, 0].abs() < SPACING
    assert not bool(level.faithful[between].any())
    assert bool(level.faithful[x[:, 0].abs() > 4 * SPACING].all())


def test_noise_excuses_what_a_cell_misses() -> None:
    where = grid(side=12)
    displacement = displacement_from_sphere(where)
    generator = torch.Generator().manual_seed(1)
    displacement = displacement + 0.1 * SPACING * torch.randn(
        displacement.shape, generator=generator
    )
    strict = solve_level(where, displacement, 1e-2, noise=0.0).level.faithful
    lenient = solve_level(where, displacement, 1e-2, noise=SPACING).level.faithful
    assert float(strict.float().mean()) < 0.5
    assert bool(lenient.all())
