"""The linear solve: equation (3) is a least-squares problem in the coefficients of the energy.

With v = grad phi and phi linear in its coefficients c, the trajectory loss is ||A c - b||^2. The
queries sit on a regular pattern in every cell, so that A is one small matrix for all cells and a
product with the normal matrix is two dense multiplications between a gather and a scatter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from udflow.compiled import over_rows
from udflow.errors import Diverged
from udflow.fields.spline import SplineGrid, SplineLevel, quadratic_weights
from udflow.fit.linear_loops import products

_VALUE_WEIGHT = 0.05  # of the energy's own value against its three slopes
_TOLERANCE = 1e-3
_EASY = 1e-2  # smoothness up to which
_ITERATIONS = 10  # are enough: more change the field by less than its error
_MOST_ITERATIONS = 100  # beyond it they grow like its root, up to here
_SLACK = 0.04  # cells by which slopes may miss their displacement
_MIDDLE = 13  # of the 27 nodes of a cell, the one at its centre
_THIRD_DIFFERENCE = (-1.0, 3.0, -3.0, 1.0)
_PARTS = 2  # of the cells, whose products are summed apart


@dataclass(frozen=True)
class LinearFit:
    """A solved level.

    Attributes:
        level: the level.
        residual: mean squared residual of its slopes, in units of length squared.
        iterations: of the solver.
    """

    level: SplineLevel
    residual: float
    iterations: int


def solve_level(
    grid: SplineGrid, displacement: Tensor, smoothness: float, noise: float = math.inf
) -> LinearFit:
    """The energy on a grid whose slopes point away from the surface.

    Minimises sum ||grad E(x) - (x - foot)||^2 + w (E(x) - |x - foot|^2 / 2)^2 over the centres x
    of the cells, plus smoothness times the squared third differences of the coefficients, which
    leave quadratic energies (planes) alone.

    Args:
        grid: cells and nodes.
        displacement: x - foot at the centres of the cells, (c, 3), unit frame.
        smoothness: weight of the third differences, > 0.
        noise: of the displacements, unit frame; cells that miss theirs, on average with those
            around, by more than the noise and a small share of a cell are not faithful.

    Raises:
        Diverged: the targets or the solution are not finite.
    """
    if not bool(torch.isfinite(displacement).all()):
        raise Diverged(
            "the targets of the fit are not finite; check the cloud for coordinates that differ "
            "by many orders of magnitude"
        )
    system = _NormalSystem.of(grid, displacement / grid.spacing, smoothness)
    coefficients, iterations = _conjugate_gradients(system, system.start(), _limit(smoothness))
    if not bool(torch.isfinite(coefficients).all()):
        raise Diverged("the linear solve did not stay finite; choose a larger spline.smoothness")
    slack = system.slack(coefficients)
    faithful = system.around(slack.square()).sqrt() <= max(noise / grid.spacing, _SLACK)
    level = SplineLevel(grid, coefficients, coefficients[system.cell_nodes], faithful)
    residual = float(slack.square().mean()) * grid.spacing**2
    return LinearFit(level, residual, iterations)


@dataclass(frozen=True)
class _NormalSystem:
    """The normal equations, as products.

    Attributes:
        nodes: number of unknowns.
        cell_nodes: (c, 27) unknowns of every cell.
        design: (4, 27) what the query at a cell's centre observes.
        observed: (c, 4) right-hand sides: three slopes and a value.
        runs: (m, 4) nodes in a row, for the third differences.
        smoothness: weight of a third difference.
    """

    nodes: int
    cell_nodes: Tensor
    design: Tensor
    observed: Tensor
    runs: Tensor
    smoothness: float

    @classmethod
    def of(cls, grid: SplineGrid, displacement: Tensor, smoothness: float) -> _NormalSystem:
        energy = 0.5 * displacement.square().sum(dim=1, keepdim=True)
        return cls(
            nodes=len(grid.nodes),
            cell_nodes=grid.nodes_of_cells(),
            design=_design(displacement.device),
            observed=torch.cat([displacement, _VALUE_WEIGHT**0.5 * energy], dim=1),
            runs=_runs_of_four(grid),
            smoothness=smoothness,
        )

    def product(self, coefficients: Tensor) -> Tensor:
        """(A^T A + smoothness D^T D) c."""
        by = self.product_by_loop if coefficients.device.type == "cpu" else self.product_by_tensors
        return by(coefficients)

    def product_by_loop(self, coefficients: Tensor) -> Tensor:
        """`product` on the CPU."""
        sums = coefficients.new_empty(_PARTS, self.nodes)
        arrays = coefficients.numpy(), self._columns.numpy(), self._short_runs.numpy()
        numbers = _VALUE_WEIGHT, self.smoothness
        over_rows(products, _PARTS, *arrays, *numbers, sums.numpy(), least=1)
        return sums.sum(dim=0)

    def product_by_tensors(self, coefficients: Tensor) -> Tensor:
        """`product` on any device."""
        observed = coefficients[self.cell_nodes] @ self.design.T
        result = self.scattered(observed @ self.design)
        kernel = coefficients.new_tensor(_THIRD_DIFFERENCE)
        third = (coefficients[self.runs] @ kernel) * self.smoothness
        return result.index_add_(0, self.runs.flatten(), torch.outer(third, kernel).flatten())

    def right_hand_side(self) -> Tensor:
        """A^T b."""
        return self.scattered(self.observed @ self.design)

    def diagonal(self) -> Tensor:
        """Diagonal of the normal matrix, for the preconditioner."""
        squares = self.design.square().sum(dim=0).expand(len(self.cell_nodes), -1)
        diagonal = self.scattered(squares)
        kernel = diagonal.new_tensor(_THIRD_DIFFERENCE).square() * self.smoothness
        return diagonal.index_add_(0, self.runs.flatten(), kernel.repeat(len(self.runs))).clamp_min(
            1e-6
        )

    def start(self) -> Tensor:
        """A first guess: per node the mean energy of the cells that use it."""
        energy = self.observed[:, 3:] / _VALUE_WEIGHT**0.5
        total = self.scattered(energy.expand(-1, 27))
        return total / self.sharing.clamp_min(1)

    @cached_property
    def sharing(self) -> Tensor:
        """(n,) number of cells that use each node."""
        return self.scattered(torch.ones_like(self.observed[:, :1]).expand(-1, 27))

    def slack(self, coefficients: Tensor) -> Tensor:
        """(c,) norm of the slope residual at every query, in cells."""
        slopes = coefficients[self.cell_nodes] @ self.design[:3].T
        return (slopes - self.observed[:, :3]).norm(dim=1)

    def around(self, per_cell: Tensor) -> Tensor:
        """Mean of (c,) values over each cell and those that touch it."""
        total = self.scattered(per_cell[:, None].expand(-1, 27))
        middle = self.cell_nodes[:, _MIDDLE]
        return total[middle] / self.sharing[middle]

    @cached_property
    def _columns(self) -> Tensor:
        return self.cell_nodes[:, ::3].int()

    @cached_property
    def _short_runs(self) -> Tensor:
        return self.runs.int()

    def scattered(self, per_cell: Tensor) -> Tensor:
        """Sum of (c, 27) contributions per node."""
        result = per_cell.new_zeros(self.nodes)
        return result.index_add_(0, self.cell_nodes.flatten(), per_cell.flatten())


def _design(device: torch.device) -> Tensor:
    """Slopes and weighted value of the 27 basis functions at the centre of a cell, (4, 27)."""
    values, slopes = quadratic_weights(torch.zeros(1, 1, device=device))
    b, d = values[0, :, 0], slopes[0, :, 0]
    rows = [(d, b, b), (b, d, b), (b, b, d), (_VALUE_WEIGHT**0.5 * b, b, b)]
    return torch.stack([torch.einsum("i,j,k->ijk", x, y, z).flatten() for x, y, z in rows])


def _runs_of_four(grid: SplineGrid) -> Tensor:
    """(m, 4) numbers of nodes that are consecutive along an axis."""
    coordinates = grid.nodes.coordinates
    runs = []
    for step in torch.eye(3, dtype=torch.int64, device=coordinates.device):
        following = torch.cat([grid.nodes.find(coordinates + step), coordinates.new_tensor([-1])])
        run = [torch.arange(len(coordinates), device=coordinates.device)]
        for _ in range(3):
            run.append(following[run[-1]])  # -1 reads the last entry, -1
        runs.append(torch.stack(run, dim=1)[run[-1] >= 0])
    return torch.cat(runs)


def _limit(smoothness: float) -> int:
    """Iterations allowed: the condition of the system grows in proportion to its smoothness."""
    growth = max(1.0, smoothness / _EASY) ** 0.5
    return round(min(_ITERATIONS * growth, _MOST_ITERATIONS))


def _conjugate_gradients(system: _NormalSystem, start: Tensor, limit: int) -> tuple[Tensor, int]:
    """Conjugate gradients with a diagonal preconditioner; returns solution and iterations."""
    c = start.clone()
    right = system.right_hand_side()
    inverse_diagonal = system.diagonal().reciprocal()
    residual = right - system.product(c)
    z = residual * inverse_diagonal
    direction = z
    rho = residual.dot(z)
    enough = _TOLERANCE * right.norm()
    for iteration in range(limit):
        if bool(residual.norm() <= enough):
            return c, iteration
        image = system.product(direction)
        alpha = rho / direction.dot(image)
        c = c + alpha * direction
        residual = residual - alpha * image
        z = residual * inverse_diagonal
        rho, previous = residual.dot(z), rho
        direction = z + (rho / previous) * direction
    return c, limit
