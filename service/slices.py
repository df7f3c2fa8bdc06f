"""Planes through a field: where the cells of the grid lie, and a picture of the distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.problems import invalid
from service.requests import Slice

Vector = NDArray[np.float64]
Image = NDArray[np.uint8]

_AXES = {"x": 0, "y": 1, "z": 2}
_LINES = 10  # isolines across the largest distance, about
_MIN_SINE = 1e-6
# dark blue at the surface over green to light yellow far from it; even in lightness
_COLORS = np.array(
    [[26, 28, 84], [33, 86, 140], [38, 141, 142], [84, 190, 118], [184, 218, 97], [250, 240, 170]]
)
_SURFACE = np.array([255, 92, 72])


@dataclass(frozen=True)
class Plane:
    """A grid of square cells in space.

    Attributes:
        first: centre of the cell in row 0, column 0, world frame; row 0 is the top.
        right, down: from one cell to the next in a row, and in a column.
        rows, columns: size of the grid.
    """

    first: Vector
    right: Vector
    down: Vector
    rows: int
    columns: int

    @property
    def cell(self) -> float:
        """Edge of a cell in units of the scan."""
        return float(np.linalg.norm(self.right))

    def points(self) -> Vector:
        """(rows * columns, 3) centres, row by row."""
        row, column = np.mgrid[: self.rows, : self.columns]
        return self.first + column.reshape(-1, 1) * self.right + row.reshape(-1, 1) * self.down


def plane_of(wish: Slice, low: Vector, high: Vector) -> Plane:
    """The grid that a request asks for.

    Args:
        low, high: corners of the box to show; they decide what the request leaves open.

    Raises:
        Problem: 422, the normal has no length, or up is parallel to it.
    """
    right, up = _basis(wish)
    origin = _origin(wish, 0.5 * (low + high))
    across = np.array([_extent(right, low, high), _extent(up, low, high)])
    if wish.width is not None and wish.height is not None:
        across = np.array([wish.width, wish.height])
    else:
        centre = 0.5 * (low + high) - origin
        origin = origin + right * (centre @ right) + up * (centre @ up)
    cell = float(across.max()) / wish.resolution
    columns, rows = (max(1, round(length / cell)) for length in across)
    first = origin - right * cell * (columns - 1) / 2 + up * cell * (rows - 1) / 2
    return Plane(first, right * cell, -up * cell, rows, columns)


def _basis(wish: Slice) -> tuple[Vector, Vector]:
    """Unit vectors to the right and up in the plane, right-handed with the normal."""
    normal = np.zeros(3)
    normal[_AXES[wish.axis or "z"]] = -1.0 if wish.axis == "y" else 1.0  # x right, z up
    if wish.normal is not None:
        normal = np.asarray(wish.normal)
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        raise invalid("#/normal", "invalid_value", "the normal has no length")
    normal = normal / length
    up = np.asarray(wish.up if wish.up is not None else _natural_up(normal), np.float64)
    right = np.cross(up, normal)
    sine = float(np.linalg.norm(right))
    if sine <= _MIN_SINE * float(np.linalg.norm(up)):
        raise invalid("#/up", "invalid_value", "up must have a part across the normal")
    right = right / sine
    return right, np.cross(normal, right)


def _natural_up(normal: Vector) -> Vector:
    return np.array([0.0, 1.0, 0.0] if abs(normal[2]) > 0.9 else [0.0, 0.0, 1.0])


def _origin(wish: Slice, centre: Vector) -> Vector:
    if wish.origin is not None:
        return np.asarray(wish.origin, np.float64)
    if wish.axis is not None and wish.at is not None:
        centre = centre.copy()
        centre[_AXES[wish.axis]] = wish.at
    return centre


def _extent(direction: Vector, low: Vector, high: Vector) -> float:
    return float(np.abs(direction) @ (high - low))


def picture(distance: Vector, cell: float, isolines: bool) -> tuple[Image, float]:
    """(rows, columns, 4) RGBA of distances (rows, columns); the step between isolines, 0 for none.

    cell: edge of a pixel in units of the distances. The surface itself is drawn in red, about two
    pixels wide.
    """
    top = float(distance.max()) or 1.0
    place = np.clip(distance / top, 0.0, 1.0) ** 0.5 * (len(_COLORS) - 1)
    lower = np.minimum(place.astype(np.int64), len(_COLORS) - 2)
    share = (place - lower)[..., None]
    color = _COLORS[lower] * (1.0 - share) + _COLORS[lower + 1] * share
    step = _round_step(top / _LINES) if isolines else 0.0
    if step > 2.0 * cell:
        off = np.abs(distance - np.rint(distance / step) * step) / cell
        line = np.clip(1.1 - off, 0.0, 1.0) * (distance > 0.5 * step)
        color *= (1.0 - 0.55 * line)[..., None]
    surface = np.clip(1.5 - distance / cell, 0.0, 1.0)[..., None]
    color = color * (1.0 - surface) + _SURFACE * surface
    opaque = np.full((*distance.shape, 1), 255.0)
    return np.rint(np.concatenate([color, opaque], axis=2)).astype(np.uint8), step


def _round_step(length: float) -> float:
    """1, 2 or 5 times a power of ten, nearest above."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(power * k for k in (1.0, 2.0, 5.0, 10.0) if power * k >= length * 0.999))
