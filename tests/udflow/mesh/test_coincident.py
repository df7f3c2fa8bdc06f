"""Vertices in one place: made one where the surface allows it, else told apart."""

from __future__ import annotations

import numpy as np
import pytest

from udflow.mesh.coincident import NEAR, without_coincident
from udflow.mesh.load import weld
from udflow.mesh.mesh import Mesh
from udflow.metrics.topology import topology

VOXEL = 1.0


def octahedron(x: float = 0.0) -> Mesh:
    vertices = np.concatenate([np.eye(3), -np.eye(3)]) + np.array([x, 0, 0])
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    return Mesh(vertices, np.array(faces))


def joined(*meshes: Mesh) -> Mesh:
    start = np.cumsum([0] + [len(m.vertices) for m in meshes])
    faces = [m.faces + first for m, first in zip(meshes, start[:-1], strict=True)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def sheet(n: int = 6) -> Mesh:
    """A plane of n x n squares, each two triangles."""
    row, column = np.divmod(np.arange((n + 1) ** 2), n + 1)
    vertices = np.stack([row, column, np.zeros_like(row)], axis=1).astype(float)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    lower = np.stack([corner, corner + n + 1, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n + 2], axis=1)
    return Mesh(vertices, np.concatenate([lower, upper]))


def nearest_two(mesh: Mesh) -> float:
    apart = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


def welded(mesh: Mesh) -> Mesh:
    return Mesh(*weld(mesh.vertices, mesh.faces, 1e-6))


def test_a_mesh_without_such_vertices_is_left_alone() -> None:
    mesh = octahedron()
    assert without_coincident(mesh, VOXEL) is mesh


@pytest.mark.parametrize("edge", [(24, 25), (24, 31), (0, 1), (3, 10)])
def test_an_edge_without_length_goes_with_its_faces(edge: tuple[int, int]) -> None:
    mesh = sheet()
    mesh.vertices[edge[1]] = mesh.vertices[edge[0]] + 0.3 * NEAR
    result = without_coincident(mesh, VOXEL)
    before, after = topology(mesh), topology(result)
    assert (after.euler_number, after.boundary_loops, after.nonmanifold_edges) == (1, 1, 0)
    assert after.vertices == before.vertices - 1
    assert nearest_two(result) > NEAR


def test_many_in_one_place_become_one() -> None:
    mesh = sheet()
    mesh.vertices[[16, 17, 24, 31, 32]] = mesh.vertices[24]
    result = without_coincident(mesh, VOXEL)
    assert len(result.vertices) == len(mesh.vertices) - 4
    assert topology(result).euler_number == 1
    assert nearest_two(result) > NEAR


def test_two_faces_folded_onto_each_other_go() -> None:
    mesh = sheet()
    tips = [24, 32]  # of the faces on both sides of the edge from 25 to 31
    mesh.vertices[tips[1]] = mesh.vertices[tips[0]]
    result = without_coincident(mesh, VOXEL)
    after = topology(result)
    assert (after.euler_number, after.boundary_loops, after.nonmanifold_edges) == (1, 1, 0)
    assert len(result.faces) == len(mesh.faces) - 2
    assert nearest_two(result) > NEAR


def test_bodies_that_touch_in_a_vertex_stay_two() -> None:
    mesh = joined(octahedron(), octahedron(2.0))
    assert topology(welded(mesh)).components == 1
    result = without_coincident(mesh, VOXEL)
    after = topology(welded(result))
    assert (after.components, after.euler_number, after.watertight) == (2, 4, True)
    np.testing.assert_allclose(result.vertices, mesh.vertices, atol=2 * NEAR)


def test_a_waist_of_three_edges_is_not_pinched_off() -> None:
    waist = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1]])
    tube = _tube(waist)
    before = topology(tube)
    result = without_coincident(tube, VOXEL)
    after = topology(welded(result))
    assert (after.components, after.euler_number) == (1, before.euler_number)
    assert after.watertight


def _tube(waist: np.ndarray) -> Mesh:
    """Two pyramids over triangles, joined at a waist of three vertices in one place."""
    angle = 2 * np.pi * np.arange(3) / 3
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)
    tips = np.array([[0.0, 0, -1], [0, 0, 3]])
    vertices = np.concatenate([tips[:1], ring, waist, ring + tips[1:] / 1.5, tips[1:]])
    faces = [[0, 1 + (i + 1) % 3, 1 + i] for i in range(3)]
    for low in (1, 4):
        for i in range(3):
            j = (i + 1) % 3
            faces += [[low + i, low + j, low + 3 + i], [low + j, low + 3 + j, low + 3 + i]]
    faces += [[10, 7 + i, 7 + (i + 1) % 3] for i in range(3)]
    return Mesh(vertices, np.array(faces))


@pytest.mark.parametrize("faces", [4, 1])
def test_a_body_smaller_than_that_stays(faces: int) -> None:
    corners = 0.1 * NEAR * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    result = without_coincident(Mesh(corners, tetrahedron[:faces]), VOXEL)
    assert len(result.faces) == faces


def test_colours_stay_with_their_vertices() -> None:
    mesh = sheet()
    mesh.vertices[25] = mesh.vertices[24]
    colors = (np.arange(len(mesh.vertices))[:, None] * [1, 2, 3]).astype(np.uint8)
    result = without_coincident(Mesh(mesh.vertices, mesh.faces, colors), VOXEL)
    assert result.colors is not None
    kept = np.delete(np.arange(len(mesh.vertices)), 25)
    np.testing.assert_array_equal(result.colors, colors[kept])
    np.testing.assert_array_equal(result.vertices, mesh.vertices[kept])
