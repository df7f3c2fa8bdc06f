"""Which columns of a file a reader keeps, and the arrays they become."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Wanted:
    """Column numbers of coordinates, colours and normals; None where the file has none."""

    points: Triple
    colors: Triple | None = None
    normals: Triple | None = None

    @property
    def flat(self) -> tuple[int, ...]:
        """All columns: coordinates, then colours, then normals."""
        return self.points + (self.colors or ()) + (self.normals or ())


@dataclass(frozen=True)
class Raw:
    """What a reader found: points (n, 3) float64, colors (n, 3) on any scale, normals (n, 3)."""

    points: NDArray[np.float64]
    colors: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None


def triple(names: Sequence[str], wanted: Sequence[str]) -> Triple | None:
    """The positions of three names, or None unless all are there."""
    if not set(wanted) <= set(names):
        return None
    a, b, c = (names.index(name) for name in wanted)
    return a, b, c


def first_triple(names: Sequence[str], choices: Iterable[Sequence[str]]) -> Triple | None:
    """The positions of the first choice of three names that is there as a whole."""
    return next((found for choice in choices if (found := triple(names, choice))), None)


def wanted_by_value(sample: NDArray[np.float64]) -> Wanted:
    """Coordinates first; colours and normals among further columns are told by their values."""
    colors: Triple | None = None
    normals: Triple | None = None
    column = 3
    while column + 3 <= sample.shape[1]:
        three = (column, column + 1, column + 2)
        values = sample[:, three]
        if normals is None and _are_normals(values):
            normals, column = three, column + 3
        elif colors is None and _are_colors(values):
            colors, column = three, column + 3
        else:
            column += 1
    return Wanted((0, 1, 2), colors, normals)


def _are_normals(values: NDArray[np.float64]) -> bool:
    length = np.sqrt(np.square(values).sum(axis=1))
    return bool(np.count_nonzero(np.abs(length - 1.0) < 0.02) > 0.8 * len(values))


def _are_colors(values: NDArray[np.float64]) -> bool:
    whole = bool(np.isfinite(values).all()) and bool((values == np.rint(values)).all())
    return whole and float(values.min()) >= 0.0 and 1.0 < float(values.max()) <= 255.0


def from_table(table: NDArray[np.float64], wanted: Wanted, *, whole_colors: bool = False) -> Raw:
    """Split a float table whose columns are `wanted.flat`.

    Args:
        whole_colors: colours are declared as whole numbers, so that 1 is nearly black, not full.
    """
    colors: NDArray[Any] | None = None
    if wanted.colors:
        colors = table[:, 3:6].astype(np.float32)
        if whole_colors and bool(np.isfinite(colors).all()):
            colors = np.clip(colors, -1, 2**16).astype(np.int32)
    normals = table[:, -3:].astype(np.float32) if wanted.normals else None
    return Raw(table[:, :3], colors, normals)


def from_records(chunks: Iterable[NDArray[Any]], count: int, wanted: Wanted) -> Raw:
    """Collect `count` records that come in chunks; their fields are named p0, p1, ..."""
    raw: Raw | None = None
    start = 0
    for chunk in chunks:
        raw = raw or _room(chunk.dtype, count, wanted)
        _put(raw.points, chunk, wanted.points, start)
        if raw.colors is not None and wanted.colors:
            _put(raw.colors, chunk, wanted.colors, start)
        if raw.normals is not None and wanted.normals:
            _put(raw.normals, chunk, wanted.normals, start)
        start += len(chunk)
    return raw or Raw(np.empty((0, 3)))


def _room(dtype: np.dtype[Any], count: int, wanted: Wanted) -> Raw:
    colors = normals = None
    if wanted.colors:
        kinds = [dtype[f"p{column}"].newbyteorder("=") for column in wanted.colors]
        colors = np.empty((count, 3), np.result_type(*kinds))
    if wanted.normals:
        normals = np.empty((count, 3), np.float32)
    return Raw(np.empty((count, 3)), colors, normals)


def _put(target: NDArray[Any], chunk: NDArray[Any], columns: Triple, start: int) -> None:
    for axis, column in enumerate(columns):
        target[start : start + len(chunk), axis] = chunk[f"p{column}"]
