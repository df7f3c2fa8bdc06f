"""Steps down a spline energy, point by point: `SplineLevel.normal_gradient` as a compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from udflow.compiled import Array, compiled
from udflow.fields.lattice_loops import number_of

Triple = tuple[Any, Any, Any]  # single precision
_CURVATURES = (np.float32(1.0), np.float32(-2.0), np.float32(1.0))


@compiled
def normal_steps(
    start: int, stop: int, points: Array, origin: Array, spacing: float, shape: Array,
    table: Array, leaves: Array, rows: Array, steps: int, moved: Array, cells: Array,
) -> None:  # fmt: skip
    """Moves points start..stop by -(Hess E) grad E, `steps` times or until they leave the band.

    Args:
        start, stop: rows.
        points: (n, 3).
        origin, spacing: of the grid, (3,) and the edge of a cell.
        shape, table, leaves: its cells, as in `SparseLattice`.
        rows: (c, 27) coefficients of each cell.
        steps: how many.
        moved: (n, 3), filled in.
        cells: (n, 2) int64, filled in: the cell in which a point began and the one in which it
            ended, -1 outside the band. A point that left the band in between ends outside.
    """
    edge = np.float32(spacing)
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        cell, at = _cell(x, y, z, origin, edge, shape, table, leaves)
        cells[i, 0] = cell
        for _ in range(steps):
            if cell < 0:
                break
            down = _product(rows[cell], _values(at[0]), _slopes(at[0]), _values(at[1]),
                            _slopes(at[1]), _values(at[2]), _slopes(at[2]))  # fmt: skip
            x, y, z = x - edge * down[0], y - edge * down[1], z - edge * down[2]
            cell, at = _cell(x, y, z, origin, edge, shape, table, leaves)
        cells[i, 1] = cell
        moved[i, 0], moved[i, 1], moved[i, 2] = x, y, z


@compiled
def _cell(
    x: Any, y: Any, z: Any, origin: Array, edge: Any, shape: Array, table: Array,
    leaves: Array,
) -> tuple[int, Triple]:  # fmt: skip
    """The number of the cell that a point lies in, -1 for none, and where in it, -1/2..1/2."""
    u, v, w = (x - origin[0]) / edge, (y - origin[1]) / edge, (z - origin[2]) / edge
    a, b, c = np.rint(u), np.rint(v), np.rint(w)
    at = (u - a, v - b, w - c)
    # the comparison as floats sends away what is no number, and what no integer holds
    if not (0 <= a < shape[0] and 0 <= b < shape[1] and 0 <= c < shape[2]):
        return -1, at
    return number_of(int(a), int(b), int(c), shape, table, leaves), at


@compiled
def _values(r: float) -> Triple:
    """The quadratic B-splines of the nodes at -1, 0 and 1, at r."""
    low, high = np.float32(0.5) - r, np.float32(0.5) + r
    return np.float32(0.5) * low * low, np.float32(0.75) - r * r, np.float32(0.5) * high * high


@compiled
def _slopes(r: float) -> Triple:
    return r - np.float32(0.5), np.float32(-2.0) * r, r + np.float32(0.5)


@compiled
def _product(
    row: Array, vx: Triple, sx: Triple, vy: Triple, sy: Triple, vz: Triple, sz: Triple
) -> Triple:
    """(Hess E) grad E from the 27 coefficients of a cell, values v and slopes s along each axis."""
    zero = np.float32(0.0)
    gx, gy, gz = zero, zero, zero
    hxx, hxy, hxz, hyy, hyz, hzz = zero, zero, zero, zero, zero, zero
    for i in range(3):
        y_z, dy_z, ddy_z, y_dz, dy_dz, y_ddz = zero, zero, zero, zero, zero, zero
        for j in range(3):
            k = 9 * i + 3 * j
            low, middle, high = row[k], row[k + 1], row[k + 2]
            z = low * vz[0] + middle * vz[1] + high * vz[2]
            dz = low * sz[0] + middle * sz[1] + high * sz[2]
            ddz = low - middle - middle + high
            y_z, dy_z, ddy_z = y_z + z * vy[j], dy_z + z * sy[j], ddy_z + z * _CURVATURES[j]
            y_dz, dy_dz, y_ddz = y_dz + dz * vy[j], dy_dz + dz * sy[j], y_ddz + ddz * vy[j]
        gx, gy, gz = gx + y_z * sx[i], gy + dy_z * vx[i], gz + y_dz * vx[i]
        hxx, hxy, hxz = hxx + y_z * _CURVATURES[i], hxy + dy_z * sx[i], hxz + y_dz * sx[i]
        hyy, hyz, hzz = hyy + ddy_z * vx[i], hyz + dy_dz * vx[i], hzz + y_ddz * vx[i]
    return (
        hxx * gx + hxy * gy + hxz * gz,
        hxy * gx + hyy * gy + hyz * gz,
        hxz * gx + hyz * gy + hzz * gz,
    )
