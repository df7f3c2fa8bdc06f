"""Pictures of clouds and meshes without a GPU: a z-buffer.

Three pixels in each direction are drawn for one that is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh
from udflow.picture_loops import draw_discs, draw_triangles

Image = NDArray[np.uint8]
Vectors = NDArray[np.float64]

_FINER = 3  # pixels drawn in each direction for one that is kept
_MARGIN = 0.06  # of the picture, left free on each side


@dataclass(frozen=True)
class View:
    """Where the camera stands: parallel projection, Z up.

    Attributes:
        azimuth, elevation: degrees; azimuth 0 looks along +Y, from in front.
        centre: what lies in the middle.
        extent: length that fills the shorter side, without the margins.
    """

    centre: tuple[float, float, float]
    extent: float
    azimuth: float = -35.0
    elevation: float = 22.0

    @classmethod
    def around(cls, points: Vectors, azimuth: float = -35.0, elevation: float = 22.0) -> View:
        """The view that shows all of the points (n, 3), with their picture in the middle."""
        base = cls((0.0, 0.0, 0.0), 1.0, azimuth, elevation)
        seen = points @ base.axes().T
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle = (low + high) / 2 @ base.axes()
        extent = float(max(high[0] - low[0], high[1] - low[1])) or 1.0
        centre = (float(middle[0]), float(middle[1]), float(middle[2]))
        return cls(centre, extent, azimuth, elevation)

    def axes(self) -> Vectors:
        """(3, 3): right, up and towards the camera."""
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([np.cos(a), np.sin(a), 0.0])
        towards = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
        return np.stack([right, np.cross(towards, right), towards])


def mesh_picture(mesh: Mesh, size: tuple[int, int] = (480, 480), view: View | None = None) -> Image:
    """(height, width, 4) RGBA of a mesh, its colours if it has some; both sides are lit alike.

    Args:
        size: width and height in pixels.
        view: None shows all of it.
    """
    canvas = _Canvas(size, view or View.around(mesh.vertices))
    corners = canvas.projected(mesh.vertices)
    normal = _vertex_normals(mesh) @ canvas.view.axes().T
    color = _PORCELAIN if mesh.colors is None else (mesh.colors / 255.0) ** 2.2
    shade = np.broadcast_to(color, normal.shape) * _light(normal)[:, None]
    draw_triangles(mesh.faces, corners, shade, canvas.depth, canvas.light)
    return canvas.finished(relief=0.35)


def points_picture(
    points: Vectors,
    colors: NDArray[np.uint8] | None = None,
    size: tuple[int, int] = (480, 480),
    view: View | None = None,
    radius: float = 1.2,
) -> Image:
    """(height, width, 4) RGBA of a cloud as round dots.

    Args:
        points: (n, 3).
        colors: (n, 3) sRGB; None draws all in one ink.
        radius: of a dot, in pixels.
    """
    canvas = _Canvas(size, view or View.around(points))
    shade = np.broadcast_to(_INK if colors is None else (colors / 255.0) ** 2.2, points.shape)
    place = canvas.projected(points)
    draw_discs(place, np.ascontiguousarray(shade), radius * _FINER, canvas.depth, canvas.light)
    return canvas.finished(relief=0.5)


_PORCELAIN = np.array([0.66, 0.68, 0.70])
_INK = np.array([0.02, 0.05, 0.08])
_LIGHTS = ((np.array([-0.45, 0.6, 0.66]), 0.78), (np.array([0.8, -0.1, 0.59]), 0.2))
_AMBIENT = 0.2


def _light(normal: Vectors) -> NDArray[np.float64]:
    """(n,) brightness of unit normals in the camera's frame; the side seen is the lit one."""
    facing = np.where(normal[:, 2:] < 0.0, -normal, normal)
    light = np.full(len(normal), _AMBIENT)
    for direction, strength in _LIGHTS:
        light += strength * np.clip(facing @ direction, 0.0, None)
    return light


def _vertex_normals(mesh: Mesh) -> Vectors:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    columns = [
        np.bincount(mesh.faces.ravel(), np.repeat(face[:, i], 3), len(mesh.vertices))
        for i in range(3)
    ]
    total = np.stack(columns, axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals: Vectors = total / np.where(length > 0.0, length, 1.0)
    return normals


class _Canvas:
    """A z-buffer with linear light."""

    def __init__(self, size: tuple[int, int], view: View) -> None:
        self.view = view
        self.width, self.height = size[0] * _FINER, size[1] * _FINER
        self._scale = (1 - 2 * _MARGIN) * min(self.width, self.height) / view.extent
        self.depth = np.full((self.height, self.width), -np.inf)
        self.light = np.zeros((self.height, self.width, 3))

    def projected(self, points: Vectors) -> Vectors:
        """(n, 3): column, row (downwards) and nearness, all in drawn pixels."""
        seen = (points - np.array(self.view.centre)) @ self.view.axes().T * self._scale
        return seen * [1.0, -1.0, 1.0] + [self.width / 2, self.height / 2, 0.0]

    def finished(self, relief: float) -> Image:
        """The picture at its own size; what lies behind its neighbours is darkened."""
        light = self.light * self._shadow(self.depth, relief)[..., None]
        covered = np.isfinite(self.depth).astype(np.float64)
        share = _smaller(covered)
        mean = np.stack([_smaller(light[..., i] * covered) for i in range(3)], axis=-1)
        mean /= np.where(share > 0.0, share, 1.0)[..., None]
        color = np.clip(mean, 0.0, 1.0) ** (1 / 2.2)
        pixels = np.rint(np.concatenate([color, share[..., None]], axis=-1) * 255.0)
        image: Image = pixels.astype(np.uint8)
        return image

    def _shadow(self, depth: Vectors, strength: float) -> Vectors:
        """Brightness 0..1: lower the more a pixel lies behind those around it."""
        behind = np.zeros_like(depth)
        reach = max(2, min(self.width, self.height) // 160)
        unit = 0.012 * min(self.width, self.height)
        solid = np.where(np.isfinite(depth), depth, depth[np.isfinite(depth)].min(initial=0.0))
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)):
            around = np.roll(solid, (dy * reach, dx * reach), axis=(0, 1))
            behind += np.clip((around - solid) / unit, 0.0, 1.0) / 8
        shadow: Vectors = 1.0 - strength * behind
        return shadow


def _smaller(image: Vectors) -> Vectors:
    """Means over squares of _FINER pixels."""
    height, width = image.shape
    cells = image.reshape(height // _FINER, _FINER, width // _FINER, _FINER)
    mean: Vectors = cells.mean(axis=(1, 3))
    return mean
