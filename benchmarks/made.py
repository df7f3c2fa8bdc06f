"""Ground truths made by code, for checks that must run anywhere. All lie in the unit frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

from udflow.mesh.mesh import Mesh


def torus() -> Mesh:
    """Smooth and closed, of genus 1."""
    return _mesh(trimesh.creation.torus(0.35, 0.15, major_sections=128, minor_sections=64))


def box() -> Mesh:
    """Flat faces, sharp edges and corners."""
    return _mesh(trimesh.creation.box((1.0, 0.7, 0.5)))


def bowl() -> Mesh:
    """Smooth and open: a sphere without its top quarter."""
    polar = np.linspace(0.0, 2.0 * np.pi / 3.0, 65)
    profile = 0.5 * np.column_stack([np.sin(polar), -np.cos(polar)])
    return _mesh(trimesh.creation.revolve(profile, sections=128))


def sponge() -> Mesh:
    """A cube with 20 tunnels through tunnels, of genus 81: Menger's sponge after two steps."""
    solid = np.ones((1, 1, 1), dtype=bool)
    for _ in range(2):
        solid = np.kron(solid, _drilled()).astype(bool)
    quads = np.concatenate([_walls(solid, axis) for axis in range(3)])
    corners, numbers = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    numbers = numbers.reshape(-1, 4)
    faces = np.concatenate([numbers[:, [0, 1, 2]], numbers[:, [0, 2, 3]]])
    return Mesh(corners / len(solid) - 0.5, faces)


def _drilled() -> NDArray[np.bool_]:
    """3 x 3 x 3 cubes without the middle ones of the sides and the cube."""
    middle = np.indices((3, 3, 3)) == 1
    return np.asarray(middle.sum(axis=0) < 2)


def _walls(solid: NDArray[np.bool_], axis: int) -> NDArray[np.int64]:
    """(n, 4, 3) corners of the squares between solid and empty cubes across an axis."""
    turned = np.pad(solid.transpose(np.roll([0, 1, 2], -axis)), 1).astype(int)
    change = np.diff(turned, axis=0)
    x, y, z = change.nonzero()
    base = np.stack([x, y - 1, z - 1], axis=1)[:, None]
    square = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
    found = base + np.where(change[x, y, z][:, None, None] < 0, square, square[::-1])
    return np.asarray(np.roll(found, axis, axis=2))


def _mesh(made: trimesh.Trimesh) -> Mesh:
    vertices = np.asarray(made.vertices, dtype=np.float64)
    return Mesh(vertices, np.asarray(made.faces, dtype=np.int64))


MADE: dict[str, Callable[[], Mesh]] = {"torus": torus, "box": box, "bowl": bowl}
