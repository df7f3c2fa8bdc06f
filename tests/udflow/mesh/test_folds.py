"""Spikes and flaps are drawn in; edges of solid things and borders stay."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from udflow.mesh.folds import at_folds, unfolded
from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import edges_of

PULLED = 700  # face


def ball() -> Mesh:
    found = trimesh.creation.icosphere(subdivisions=4)
    return Mesh(np.asarray(found.vertices, dtype=float), np.asarray(found.faces, dtype=np.int64))


def box() -> Mesh:
    found = trimesh.creation.box().subdivide().subdivide()
    return Mesh(np.asarray(found.vertices, dtype=float), np.asarray(found.faces, dtype=np.int64))


def flapped() -> Mesh:
    """The ball with a crest: one edge pulled far out."""
    mesh = ball()
    vertices = mesh.vertices.copy()
    vertices[mesh.faces[PULLED, :2]] *= 1.5
    return Mesh(vertices, mesh.faces)


def off(mesh: Mesh) -> NDArray[np.float64]:
    return np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1)


def test_a_flap_on_a_ball_is_drawn_in() -> None:
    mesh = flapped()
    assert off(mesh).max() > 0.4
    result = unfolded(mesh)
    assert off(result).max() < 0.1
    assert np.array_equal(result.faces, mesh.faces)


def test_what_is_far_from_folds_stays_bit_for_bit() -> None:
    mesh = flapped()
    moved = (unfolded(mesh).vertices != mesh.vertices).any(axis=1)
    apart = np.linalg.norm(ball().vertices - ball().vertices[mesh.faces[PULLED, 0]], axis=1)
    assert 0 < moved.sum() < 20
    assert apart[moved].max() < 0.3


@pytest.mark.parametrize("make", [ball, box])
def test_edges_of_solid_things_stay(make: Callable[[], Mesh]) -> None:
    mesh = make()
    assert unfolded(mesh) is mesh


def test_a_strip_of_one_side_is_flat_where_it_closes() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 3, 2]])  # facing up and down
    assert not at_folds(vertices, faces, edges_of(faces).sides_where(2)).any()


def test_borders_stay() -> None:
    grid = np.arange(9)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    vertices = np.stack([x, y, 0 * x], axis=2).reshape(-1, 3).astype(float)
    corner = (grid[:-1, None] * 9 + grid[:-1]).reshape(-1)
    faces = np.concatenate([
        np.stack([corner, corner + 9, corner + 10], axis=1),
        np.stack([corner, corner + 10, corner + 1], axis=1),
    ])  # fmt: skip
    vertices[10] = [-1.5, 1.0, 0.2]  # folded over the border
    mesh = Mesh(vertices, faces)
    edges = edges_of(faces)
    rim = np.unique(edges.ends[edges.count == 1])
    assert at_folds(vertices, faces, edges.sides_where(2))[rim].any()
    result = unfolded(mesh)
    assert np.array_equal(result.vertices[rim], vertices[rim])
    assert np.linalg.norm(result.vertices[10] - [1, 1, 0]) < 0.1
