"""The spline field: energies of equation (8) in quadratic B-splines, one level per time t_k.

v(x, t) = grad phi(x, t) with phi(x, t) = E(x) / t: for straight trajectories the ideal energy is
phi*(x, t) = dist(x)^2 / (2 t), so that every level approximates the same E = dist^2 / 2, the finer
and the nearer to the surface the smaller its time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree
from udflow.compiled import over_rows
from udflow.fields.lattice import SparseLattice, neighbour_offsets
from udflow.fields.spline_loops import normal_steps
from udflow.flow.schedule import TimeSchedule

_CHUNK = 1 << 15  # queries evaluated together: their 27 coefficients stay in the cache
_REFINEMENTS = 2  # full projections at the finest level
_NEAR = 1.5  # faithful cells of the finest level within which the spline is trusted alone


def quadratic_weights(r: Tensor) -> tuple[Tensor, Tensor]:
    """Uniform quadratic B-splines and their derivatives at r in [-1/2, 1/2] from a node.

    Args:
        r: (d, n), one row per axis.

    Returns:
        Two (d, 3, n) tensors for the nodes at -1, 0 and +1; derivatives per node spacing.
    """
    values = torch.stack([0.5 * (0.5 - r) ** 2, 0.75 - r * r, 0.5 * (0.5 + r) ** 2], dim=1)
    slopes = torch.stack([r - 0.5, -2 * r, r + 0.5], dim=1)
    return values, slopes


_CURVATURES = (1.0, -2.0, 1.0)  # second derivatives of the three splines, anywhere in a cell


def _weighted(block: Tensor, axis: int, weights: Tensor) -> Tensor:
    """Contracts an axis of three nodes with (3, n) weights; points stay in the last axis."""
    left, middle, right = block.unbind(dim=axis)
    return torch.addcmul(torch.addcmul(left * weights[0], middle, weights[1]), right, weights[2])


@dataclass(frozen=True)
class SplineGrid:
    """A band of cells and the nodes they need. Cells are centred on lattice points: a cell is
    where one set of 27 nodes is in charge.

    Attributes:
        origin: lattice point (0, 0, 0), unit frame, (3,).
        spacing: edge of a cell, unit frame.
        cells: active cells.
        nodes: active nodes, the cells and their neighbours.
    """

    origin: Tensor
    spacing: float
    cells: SparseLattice
    nodes: SparseLattice

    def nodes_of_cells(self) -> Tensor:
        """Numbers of the 27 nodes of every cell, (c, 27) int64."""
        device = self.cells.coordinates.device
        columns = neighbour_offsets(device)[1::3]
        parts = self.cells.coordinates.split(_CHUNK)
        middle = torch.cat([self.nodes.find(part[:, None] + columns) for part in parts])
        # active points are numbered with z fastest, so three in a column have adjacent numbers
        return (middle[..., None] + torch.arange(-1, 2, device=device)).flatten(1)

    def centres(self) -> Tensor:
        """(c, 3) centres of the cells, unit frame."""
        return self.origin + self.cells.coordinates * self.spacing


@dataclass(frozen=True)
class SplineLevel:
    """One energy E on its band.

    Attributes:
        grid: where it is defined.
        coefficients: (n,) one per node, in units of spacing squared.
        rows: (c, 27) the coefficients gathered per cell, for fast evaluation.
        faithful: (c,) bool, cells in which the energy follows its trajectories. A smooth energy
            cannot follow them at creases and between sheets closer than its cells.
    """

    grid: SplineGrid
    coefficients: Tensor
    rows: Tensor
    faithful: Tensor

    @classmethod
    def of(
        cls, grid: SplineGrid, coefficients: Tensor, faithful: Tensor | None = None
    ) -> SplineLevel:
        """The level with the given node coefficients, faithful everywhere unless told."""
        if faithful is None:
            faithful = torch.ones(len(grid.cells), dtype=torch.bool, device=coefficients.device)
        return cls(grid, coefficients, coefficients[grid.nodes_of_cells()], faithful)

    def covers(self, points: Tensor) -> Tensor:
        """(n,) bool, whether points lie in the band."""
        return self._cell(points)[0] >= 0

    def gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """grad E of (n, 3) points, a length vector (the displacement x - foot), and (n,) bool
        that says where it is defined; zero elsewhere."""
        inside, block, values, slopes = self._around(points)
        along_z, along_dz = _weighted(block, 2, values[2]), _weighted(block, 2, slopes[2])
        along_yz = _weighted(along_z, 1, values[1])
        gradient = torch.stack(
            [
                _weighted(along_yz, 0, slopes[0]),
                _weighted(_weighted(along_z, 1, slopes[1]), 0, values[0]),
                _weighted(_weighted(along_dz, 1, values[1]), 0, values[0]),
            ],
            dim=1,
        )
        return gradient * (self.grid.spacing * inside[:, None]), inside

    def normal_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(Hess E) grad E of (n, 3) points, and where it is defined, as in `gradient`.

        The Hessian of dist^2 / 2 near the surface is the projector n n^T on the normal (near a
        rim or a crease, on the normal plane of the curve), so that for the ideal energy this is
        grad E itself. For a fitted one it leaves out what grad E has along the surface.
        """
        inside, block, values, slopes = self._around(points)
        curvatures = torch.tensor(_CURVATURES, device=points.device)[:, None]
        z, dz = _weighted(block, 2, values[2]), _weighted(block, 2, slopes[2])
        ddz = _weighted(block, 2, curvatures)
        y_z, dy_z = _weighted(z, 1, values[1]), _weighted(z, 1, slopes[1])
        ddy_z, y_dz = _weighted(z, 1, curvatures), _weighted(dz, 1, values[1])
        dy_dz, y_ddz = _weighted(dz, 1, slopes[1]), _weighted(ddz, 1, values[1])

        gx = _weighted(y_z, 0, slopes[0])
        gy, gz = _weighted(dy_z, 0, values[0]), _weighted(y_dz, 0, values[0])
        hxx = _weighted(y_z, 0, curvatures)
        hxy, hxz = _weighted(dy_z, 0, slopes[0]), _weighted(y_dz, 0, slopes[0])
        hyy, hyz = _weighted(ddy_z, 0, values[0]), _weighted(dy_dz, 0, values[0])
        hzz = _weighted(y_ddz, 0, values[0])
        product = torch.stack(
            [
                hxx * gx + hxy * gy + hxz * gz,
                hxy * gx + hyy * gy + hyz * gz,
                hxz * gx + hyz * gy + hzz * gz,
            ],
            dim=1,
        )
        return product * (self.grid.spacing * inside[:, None]), inside

    def stepped(self, points: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """(n, 3) points moved by -(Hess E) grad E so many times, and (n, 2) the cells in which
        they began and ended, -1 outside the band. A point that leaves the band stops there."""
        by = self.stepped_by_loop if points.device.type == "cpu" else self.stepped_by_tensors
        return by(points, steps)

    def stepped_by_tensors(self, points: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """`stepped` on any device."""
        first = last = self._cell(points)[0]
        for _ in range(steps):
            points = points - self.normal_gradient(points)[0] * (last >= 0)[:, None]
            last = torch.where(last >= 0, self._cell(points)[0], -1)
        return points, torch.stack([first, last], dim=1)

    def stepped_by_loop(self, points: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """`stepped` of float32 points on the CPU."""
        grid, moved = self.grid, torch.empty_like(points)
        cells = torch.empty(len(points), 2, dtype=torch.int64)
        places = grid.cells.table.numpy(), grid.cells.leaves.numpy(), self.rows.numpy()
        where = grid.origin.numpy(), grid.spacing, np.array(grid.cells.shape), *places
        over_rows(normal_steps, len(points), points.contiguous().numpy(), *where, steps,
                  moved.numpy(), cells.numpy())  # fmt: skip
        return moved, cells

    def _around(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Where points are covered, (n,); their coefficients, (3, 3, 3, n); and the weights of
        these for values and slopes, (3, 3, n) each."""
        cell, r = self._cell(points)
        # one row per node and one column per point: every later step runs over long rows
        block = self.rows[cell.clamp_min(0)].T.contiguous().view(3, 3, 3, -1)
        values, slopes = quadratic_weights(r.T.contiguous())
        return cell >= 0, block, values, slopes

    def _cell(self, points: Tensor) -> tuple[Tensor, Tensor]:
        local = (points - self.grid.origin) / self.grid.spacing
        nearest = local.round()
        return self.grid.cells.find(nearest.long()), local - nearest


_Answer = Callable[[SplineLevel, Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class SplineField:
    """A conservative velocity field with one spline level per time of the schedule.

    Attributes:
        schedule: the times t_1 < ... < t_K.
        levels: K levels, levels[k - 1] for t_k; the last one covers the whole trained box.
    """

    schedule: TimeSchedule
    levels: tuple[SplineLevel, ...]

    def velocity(self, points: Tensor, t: float) -> Tensor:
        """v(x, t) = grad E(x) / t by the level of the smallest time >= t that covers x, (n, 3).

        Zero outside the trained box.
        """
        times = self.schedule.times
        first = next((i for i, time in enumerate(times) if time >= t - 1e-9), len(times) - 1)
        return self._finest(SplineLevel.gradient, points, first) / t

    def _finest(self, answer: _Answer, points: Tensor, first: int) -> Tensor:
        """The answer of the finest level from `first` on that covers each point, (n, 3)."""
        result, inside = answer(self.levels[first], points)
        for level in self.levels[first + 1 :]:
            missing = (~inside).nonzero().squeeze(1)
            if len(missing) == 0:
                break
            result[missing], inside[missing] = answer(level, points[missing])
        return result

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points by reverse integration, equation (4).

        A point near the surface is the state of a longer trajectory at a small time, so each
        point starts at the smallest t_k whose band covers it. The last step, to t = 0, is a full
        projection (dt_1 v(x, t_1) = grad E); it is made twice, and along the normal only.
        """
        feet, cells = self.levels[0].stepped(points, _REFINEMENTS)
        far = (cells < 0).any(dim=1).nonzero().squeeze(1)
        if len(far) > 0:
            chunks = points[far].split(_CHUNK)
            feet[far] = torch.cat([self._from_afar(chunk) for chunk in chunks])
        return feet

    def _from_afar(self, points: Tensor) -> Tensor:
        start = self._start(points)
        x = points.clone()
        for k in range(self.schedule.steps, 1, -1):
            moving = (start >= k).nonzero().squeeze(1)
            if len(moving) > 0:
                velocity = self.velocity(x[moving], self.schedule.time(k))
                x[moving] = x[moving] - self.schedule.step(k) * velocity
        for _ in range(_REFINEMENTS):
            x = self._last_step(x)
        return x

    def refine(self, points: Tensor) -> Tensor:
        """Points (n, 3) near the surface to their feet, where the finest level can tell."""
        feet, cells = self.levels[0].stepped(points, 1)
        began = cells[:, 0]
        feet = torch.where(self._faithful(began)[:, None], feet, points)
        outside = (began < 0).nonzero().squeeze(1)
        if len(outside) > 0:
            feet[outside] = self._last_step(points[outside])
        return feet

    def _last_step(self, points: Tensor) -> Tensor:
        """The last step of equation (4), from t_1 to 0: x - dt_1 v(x, t_1) = x - grad E(x), along
        the normal only."""
        return points - self._finest(SplineLevel.normal_gradient, points, 0)

    def _start(self, points: Tensor) -> Tensor:
        """(n,) smallest k whose level covers the point, K where none does."""
        start = torch.full((len(points),), self.schedule.steps, device=points.device)
        undecided = torch.arange(len(points), device=points.device)
        for k in range(1, self.schedule.steps):
            covered = self.levels[k - 1].covers(points[undecided])
            start[undecided[covered]] = k
            undecided = undecided[~covered]
        return start

    def covers(self, points: Tensor) -> Tensor:
        """(n,) bool, whether points lie in the trained box."""
        return self.levels[-1].covers(points)

    def answers(self, points: Tensor, sites: NeighbourTree) -> tuple[Tensor, Tensor]:
        """Feet of (n, 3) points, and (n,) bool, whether these lie nearby, both where the finest
        level is faithful."""
        feet, cells = self.levels[0].stepped(points, _REFINEMENTS)
        near = (feet - points).norm(dim=1) < _NEAR * self.levels[0].grid.spacing
        return feet, near & self._faithful(cells[:, 0]) & self._faithful(cells[:, 1])

    def _faithful(self, cell: Tensor) -> Tensor:
        """(n,) bool, whether these are cells of the finest level that follow their trajectories."""
        return (cell >= 0) & self.levels[0].faithful[cell.clamp_min(0)]

    @property
    def solved(self) -> bool:
        """It is: its only purpose is to answer like the quadrics, sooner."""
        return True

    @property
    def half_edge(self) -> float:
        """Half the edge of the trained box, unit frame."""
        grid = self.levels[-1].grid
        return float(-(grid.origin[0]) - 0.5 * grid.spacing)
