"""Ground truths made by code, for checks that must run anywhere. All lie in the unit frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

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


def _mesh(made: trimesh.Trimesh) -> Mesh:
    vertices = np.asarray(made.vertices, dtype=np.float64)
    return Mesh(vertices, np.asarray(made.faces, dtype=np.int64))


MADE: dict[str, Callable[[], Mesh]] = {"torus": torus, "box": box, "bowl": bowl}
