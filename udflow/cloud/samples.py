"""Scans to try things with: surfaces that a program can describe, seen by a simulated scanner.

The scanner stands around the object and above it. It hits slanted surfaces less often, and each
point is off by a little noise. The same name gives the same points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import UnknownSample

Array = NDArray[np.float64]

_NOISE = 0.0006  # standard deviation, of the largest extent
_SLANTED = 0.35  # chance to hit a surface seen edge-on, of that of one seen face-on
_SEED = 20


@dataclass(frozen=True)
class Patch:
    """A grid of positions, (rows, columns, 3), NaN where there is no surface, and its colour,
    (rows, columns, 3) in 0..255."""

    grid: Array
    color: Array | None = None


@dataclass(frozen=True)
class Sample:
    """A simulated scan.

    Attributes:
        name: in addresses and file names.
        title: for people.
        about: what it is good for, one sentence.
        points: how many.
        patches: the surface; patches may overlap in their rims only.
    """

    name: str
    title: str
    about: str
    points: int
    patches: Callable[[], list[Patch]]


def sample(name: str) -> PointCloud:
    """The simulated scan of this name, in metres, Z up.

    Raises:
        UnknownSample: there is none.
    """
    if name not in SAMPLES:
        raise UnknownSample(f'there is no sample "{name}"; choose one of: {", ".join(SAMPLES)}')
    found = SAMPLES[name]
    return _scanned(found.patches(), found.points, np.random.default_rng(_SEED))


def _scanned(patches: list[Patch], count: int, generator: np.random.Generator) -> PointCloud:
    """Points drawn by area and slant, with noise, in random order."""
    triangles = np.concatenate([_triangles(patch.grid) for patch in patches])
    triangles = np.where(np.isfinite(triangles).all(axis=(1, 2), keepdims=True), triangles, 0.0)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    weight = area * (_SLANTED + (1.0 - _SLANTED) * _facing(normal, area))
    chosen = generator.choice(len(area), count, p=weight / weight.sum())
    corner = generator.dirichlet((1.0, 1.0, 1.0), count)
    points = np.einsum("nc,ncd->nd", corner, triangles[chosen])
    noise = _NOISE * float(np.ptp(points, axis=0).max())
    points += noise * generator.standard_normal(points.shape)
    colors = None
    if all(patch.color is not None for patch in patches):
        shades = [_triangles(patch.color) for patch in patches if patch.color is not None]
        mixed = np.einsum("nc,ncd->nd", corner, np.concatenate(shades)[chosen])
        colors = np.clip(np.rint(mixed), 0, 255).astype(np.uint8)
    return PointCloud(points, colors)


def _triangles(grid: Array) -> Array:
    """(n, 3, 3) corners of the two triangles of each cell of a grid."""
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.concatenate(
        [np.stack(corners, axis=-2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    )


def _facing(normal: Array, length: Array) -> Array:
    """(n,) 0..1, how squarely the best placed of nine positions sees each triangle."""
    angle = np.arange(8) * (np.pi / 4)
    around = np.column_stack([np.cos(angle), np.sin(angle), np.full(8, 0.5)])
    views = np.vstack([around / np.linalg.norm(around, axis=1)[:, None], [0.0, 0.0, 1.0]])
    unit = normal / np.maximum(length, 1e-12)[:, None]
    facing: Array = np.abs(unit @ views.T).max(axis=1)
    return facing


def _grid(rows: Array, columns: Array) -> tuple[Array, Array]:
    """Two parameters over a grid of (rows, columns)."""
    first, second = np.meshgrid(rows, columns, indexing="ij")
    return first, second


def _turn(count: int = 361) -> Array:
    return np.linspace(0.0, 2.0 * np.pi, count)


def _vase() -> list[Patch]:
    """A thin fluted vase with glaze, open at the top; its bottom is closed."""
    height = np.linspace(0.0, 1.0, 241)
    profile = np.interp(
        height,
        [0.0, 0.03, 0.12, 0.3, 0.46, 0.62, 0.76, 0.86, 0.95, 1.0],
        [0.62, 0.66, 0.84, 1.0, 0.97, 0.74, 0.46, 0.38, 0.47, 0.6],
    )
    smooth = np.convolve(np.pad(profile, 12, mode="edge"), np.full(25, 1 / 25), mode="valid")
    z, angle = _grid(height, _turn())
    flutes = 1.0 + 0.035 * np.cos(14 * angle + 5.0 * z) * np.sin(np.pi * np.clip(z, 0, 0.8) / 0.8)
    radius = 0.105 * smooth[:, None] * flutes
    side = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.34 * z], axis=-1)
    reach, around = _grid(np.linspace(0.0, 1.0, 41), _turn())
    foot = reach * radius[0]
    bottom = np.stack([foot * np.cos(around), foot * np.sin(around), 0.0 * foot], axis=-1)
    return [Patch(side, _glaze(z, angle)), Patch(bottom, np.full(bottom.shape, 196.0))]


def _glaze(height: Array, angle: Array) -> Array:
    """Celadon that runs down over bare clay."""
    clay, celadon, rim = np.array([[186, 124, 92], [126, 168, 158], [62, 74, 82]], dtype=float)
    line = 0.2 + 0.035 * np.sin(7 * angle) + 0.02 * np.sin(17 * angle + 1.0)
    glazed = np.clip((height - line) / 0.02, 0.0, 1.0)[..., None]
    dark = np.clip((height - 0.93) / 0.03, 0.0, 1.0)[..., None]
    return (clay * (1 - glazed) + celadon * glazed) * (1 - dark) + rim * dark


_SHOULDER = np.array([0.1, 0.6])  # x and z where the axis of a sleeve begins, inside the torso
_ARM = np.array([0.37, -0.29])  # and where it leads from there
_ACROSS = np.array([0.45, 0.9])  # the second direction of a cuff; the first is y


def _shirt() -> list[Patch]:
    """A shirt as it hangs: one sheet of cloth, open at hem, neck and cuffs."""
    z, angle = _grid(np.linspace(0.0, 0.7, 201), _turn())
    width, depth = _torso(z)
    folds = 1.0 + 0.05 * np.sin(9 * angle + 4.0 * z) * np.clip(1.0 - z / 0.5, 0.0, 1.0)
    torso = np.stack([width * folds * np.cos(angle), depth * folds * np.sin(angle), z], axis=-1)
    along, around = _grid(np.linspace(0.0, 1.0, 141), _turn(181))
    radius = _sleeve_radius(along) * (1.0 + 0.05 * np.sin(24 * along + 2 * around) * along**2)
    x, up = (
        _SHOULDER[i] + _ARM[i] * along + _ACROSS[i] * radius * np.cos(around) for i in range(2)
    )
    right = _without(np.stack([x, radius * np.sin(around), up], axis=-1), _inside_torso)
    left = right * [-1.0, 1.0, 1.0]
    return [Patch(_without(torso, _inside_sleeve)), Patch(right), Patch(left)]


def _torso(height: Array) -> tuple[Array, Array]:
    """Half width and half depth at a height."""
    narrow = np.clip((height - 0.54) / 0.16, 0.0, 1.0) ** 2
    width = (0.235 + 0.02 * np.cos(4.2 * height)) * (1.0 - narrow) + 0.085 * narrow
    return width, 0.115 * (1.0 - narrow) + 0.075 * narrow


def _sleeve_radius(along: Array) -> Array:
    return 0.078 - 0.02 * along


def _without(grid: Array, hidden: Callable[[Array], NDArray[np.bool_]]) -> Array:
    """The grid with its positions that another patch covers made NaN: no surface there."""
    return np.where(hidden(grid)[..., None], np.nan, grid)


def _inside_torso(points: Array) -> NDArray[np.bool_]:
    x, y, z = np.moveaxis(points, -1, 0)
    width, depth = _torso(z)
    inside: NDArray[np.bool_] = (x / width) ** 2 + (y / depth) ** 2 < 1.0
    return inside


def _inside_sleeve(points: Array) -> NDArray[np.bool_]:
    flat = np.stack([np.abs(points[..., 0]), points[..., 2]], axis=-1) - _SHOULDER
    along, across = np.moveaxis(flat @ np.linalg.inv(np.stack([_ARM, _ACROSS])), -1, 0)
    inside: NDArray[np.bool_] = (along > 0.0) & (
        across**2 + points[..., 1] ** 2 < _sleeve_radius(along) ** 2
    )
    return inside


def _gear() -> list[Patch]:
    """A spur gear with a bore: closed, with sharp edges."""
    teeth, inner, root, tip, thick = 18, 0.014, 0.036, 0.0435, 0.016
    phase = np.array([0.0, 0.2, 0.3, 0.55, 0.65, 0.85]) / teeth * 2 * np.pi
    corners = (np.arange(teeth)[:, None] * (2 * np.pi / teeth) + phase).ravel()
    radii = np.tile([root, root, tip, tip, root, root], teeth)
    angle = np.linspace(0.0, 2 * np.pi, 1441)
    outline = np.interp(angle, np.append(corners, 2 * np.pi), np.append(radii, root))
    flank = _ring(outline, angle, np.linspace(0.0, thick, 41))
    bore = _ring(np.full_like(angle, inner), angle, np.linspace(0.0, thick, 41))
    share, _ = _grid(np.linspace(0.0, 1.0, 61), angle)
    reach = inner + share * (outline - inner)
    faces = [
        np.stack([reach * np.cos(angle), reach * np.sin(angle), np.full_like(reach, z)], axis=-1)
        for z in (0.0, thick)
    ]
    return [Patch(grid) for grid in (flank, bore, *faces)]


def _ring(radius: Array, angle: Array, height: Array) -> Array:
    z, turned = _grid(height, angle)
    return np.stack([radius * np.cos(turned), radius * np.sin(turned), z], axis=-1)


def _shells() -> list[Patch]:
    """Three nested bowls, each turned: walls inside walls, all of them open."""
    found = []
    for number, radius in enumerate((0.1, 0.072, 0.044)):
        polar, angle = _grid(np.linspace(0.0, 2.35, 181), _turn())
        bowl = radius * np.stack(
            [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), -np.cos(polar)], axis=-1
        )
        tilt, turn = 0.55 - 0.1 * number, 2.1 * number
        found.append(Patch(bowl @ _about_x(tilt).T @ _about_z(turn).T))
    return found


def _about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


SAMPLES: dict[str, Sample] = {
    found.name: found
    for found in (
        Sample("vase", "Vase", "A thin, glazed vessel: open at the top, in colour.", 9_000, _vase),
        Sample("shirt", "Shirt", "One sheet of cloth with four openings.", 9_000, _shirt),
        Sample("gear", "Gear", "A closed part with sharp edges and a bore.", 10_000, _gear),
        Sample(
            "shells", "Shells", "Three bowls inside each other: walls within walls.", 9_000, _shells
        ),
    )
}
