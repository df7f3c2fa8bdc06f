"""Products with the normal matrix, cell by cell: `linear` as compiled loops.

A cell observes its 27 coefficients at its centre, where the basis is a product of the weights
(1/8, 3/4, 1/8) and slopes (-1/2, 0, 1/2) along each axis. Cells that share nodes add to the same
sums, so each part of the cells has sums of its own; the number of parts is fixed, and with it the
order of the additions, whatever the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from udflow.compiled import Array, compiled

_B = (np.float32(0.125), np.float32(0.75), np.float32(0.125))
_D = (np.float32(-0.5), np.float32(0.0), np.float32(0.5))


@compiled
def products(
    start: int, stop: int, coefficients: Array, columns: Array, runs: Array, value_weight: float,
    smoothness: float, sums: Array,
) -> None:  # fmt: skip
    """Fills in the sums of parts start..stop: (A^T A + smoothness D^T D) c is their total.

    Args:
        start, stop: parts.
        coefficients: (n,) of the nodes.
        columns: (c, 9) int32, the lowest node of each of the nine columns of three of a cell,
            whose numbers follow each other.
        runs: (m, 4) int32 nodes in a row.
        value_weight: of the energy's value against its slopes.
        smoothness: weight of a third difference.
        sums: (p, n) float32, one row a part.
    """
    weight, stiffness = np.float32(value_weight), np.float32(smoothness)
    parts = len(sums)
    for part in range(start, stop):
        total = sums[part]
        total[:] = 0
        for cell in range(len(columns) * part // parts, len(columns) * (part + 1) // parts):
            _add_cell(coefficients, columns[cell], weight, total)
        for run in range(len(runs) * part // parts, len(runs) * (part + 1) // parts):
            _add_run(coefficients, runs[run], stiffness, total)


@compiled
def _add_cell(coefficients: Array, column: Array, weight: Any, total: Array) -> None:
    """What the centre of a cell observes, given back to the 27 nodes that it observed."""
    zero = np.float32(0.0)
    along_x, along_y, along_z, value = zero, zero, zero, zero
    for i in range(3):
        bb, db, bd = zero, zero, zero
        for j in range(3):
            node = column[3 * i + j]
            low, middle, high = coefficients[node], coefficients[node + 1], coefficients[node + 2]
            b, d = _B[0] * (low + high) + _B[1] * middle, _D[2] * (high - low)
            bb, db, bd = bb + _B[j] * b, db + _D[j] * b, bd + _B[j] * d
        along_x, along_y = along_x + _D[i] * bb, along_y + _B[i] * db
        along_z, value = along_z + _B[i] * bd, value + _B[i] * bb
    value *= weight
    for i in range(3):
        bb, db, bd = _D[i] * along_x + _B[i] * value, _B[i] * along_y, _B[i] * along_z
        for j in range(3):
            node = column[3 * i + j]
            b, d = _B[j] * bb + _D[j] * db, _D[2] * _B[j] * bd
            total[node] += _B[0] * b - d
            total[node + 1] += _B[1] * b
            total[node + 2] += _B[0] * b + d


@compiled
def _add_run(coefficients: Array, run: Array, stiffness: Any, total: Array) -> None:
    """The third difference of four nodes in a row, given back to them."""
    a, b, c, d = run[0], run[1], run[2], run[3]
    inner = coefficients[b] - coefficients[c]
    third = stiffness * (coefficients[d] - coefficients[a] + inner + inner + inner)
    total[a] -= third
    total[b] += third + third + third
    total[c] -= third + third + third
    total[d] += third
