"""Look-ups in a sparse lattice, point by point: `SparseLattice.find` as a compiled loop."""

from __future__ import annotations

from udflow.compiled import Array, compiled


@compiled
def number_of(i: int, j: int, k: int, shape: Array, table: Array, leaves: Array) -> int:
    """The number of a lattice point, -1 where it is not active or outside the lattice."""
    if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
        return -1
    leaf = table[i >> 3, j >> 3, k >> 3]
    return int(leaves[leaf, ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)])


@compiled
def find_rows(
    start: int, stop: int, coordinates: Array, shape: Array, table: Array, leaves: Array,
    number: Array,
) -> None:  # fmt: skip
    """Fills in the numbers (n,) int64 of the lattice points start..stop of (n, 3) int64."""
    for row in range(start, stop):
        i, j, k = coordinates[row, 0], coordinates[row, 1], coordinates[row, 2]
        number[row] = number_of(i, j, k, shape, table, leaves)
