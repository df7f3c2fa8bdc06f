"""Vertices end on the surface of the field, also where feet jump to and fro."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from udflow.mesh.mesh import Mesh
from udflow.mesh.settling import settled
from udflow.mesh.topology import edges_of

VOXEL = 0.05


@dataclass(frozen=True)
class Floor:
    """The plane z = 0; near the axis feet never come to rest."""

    restless: float = 0.0

    def project(self, points: Tensor) -> Tensor:
        feet = points * torch.tensor([1.0, 1.0, 0.0])
        near = points[:, :2].norm(dim=1) < self.restless
        feet[near, 2] = torch.where(points[near, 2] > 0, -VOXEL, VOXEL)
        return feet


def fan(height: float) -> Mesh:
    """Six triangles around a hub at a height."""
    angle = np.arange(6) * np.pi / 3
    ring = VOXEL * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)
    vertices = np.concatenate([[[0.0, 0.0, height]], ring])
    faces = np.stack([np.zeros(6), 1 + np.arange(6), 1 + (np.arange(6) + 1) % 6], axis=1)
    return Mesh(vertices, faces.astype(np.int64))


def test_a_vertex_off_the_surface_goes_to_its_foot() -> None:
    mesh = fan(0.5 * VOXEL)
    result = settled(mesh, Floor(), VOXEL, torch.device("cpu"))
    np.testing.assert_allclose(result.vertices[0], 0.0, atol=1e-7)
    np.testing.assert_array_equal(result.vertices[1:], mesh.vertices[1:])


def test_what_nobody_sees_is_left_alone() -> None:
    mesh = fan(0.05 * VOXEL)
    result = settled(mesh, Floor(), VOXEL, torch.device("cpu"))
    np.testing.assert_array_equal(result.vertices, mesh.vertices)


def test_a_vertex_without_a_foot_to_rest_on_is_drawn_to_a_neighbour_that_has_one() -> None:
    field = Floor(restless=0.4 * VOXEL)
    result = settled(fan(0.5 * VOXEL), field, VOXEL, torch.device("cpu"))
    hub = torch.from_numpy(result.vertices[:1]).float()
    assert float((field.project(hub) - hub).norm()) <= 0.1 * VOXEL
    assert np.linalg.norm(result.vertices[0]) < 1.1 * VOXEL


def test_what_never_comes_to_rest_is_left_out() -> None:
    restless, quiet = fan(0.5 * VOXEL), fan(0.0)
    away = quiet.vertices + np.array([1.0, 0.0, 0.0])
    faces = np.concatenate([restless.faces, quiet.faces + len(restless.vertices)])
    both = Mesh(np.concatenate([restless.vertices, away]), faces)
    result = settled(both, Floor(restless=2 * VOXEL), VOXEL, torch.device("cpu"))
    np.testing.assert_allclose(result.vertices, away)
    np.testing.assert_array_equal(result.faces, quiet.faces)


def test_a_mesh_of_which_nothing_rests_stays_whole() -> None:
    mesh = fan(0.5 * VOXEL)
    result = settled(mesh, Floor(restless=2 * VOXEL), VOXEL, torch.device("cpu"))
    np.testing.assert_array_equal(result.faces, mesh.faces)


def grid(side: int) -> Mesh:
    """A flat square of triangles around the axis."""
    step = VOXEL * (np.arange(side + 1) - side / 2)
    x, y = np.meshgrid(step, step, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return Mesh(vertices, faces.reshape(-1, 3))


def border_edges(mesh: Mesh) -> int:
    return int((edges_of(mesh.faces).count == 1).sum())


def test_the_gap_of_a_vertex_left_out_is_bridged_by_its_neighbours() -> None:
    mesh = grid(16)
    restless = Floor(restless=5.2 * VOXEL)
    result = settled(mesh, restless, VOXEL, torch.device("cpu"))
    assert len(result.vertices) < len(mesh.vertices) - 8
    assert border_edges(result) == border_edges(mesh)
    vertices = torch.from_numpy(result.vertices).float()
    assert float((restless.project(vertices) - vertices).norm(dim=1).max()) < 0.1 * VOXEL


def test_where_many_vertices_are_left_out_together_a_hole_stays() -> None:
    mesh = grid(20)
    result = settled(mesh, Floor(restless=7 * VOXEL), VOXEL, torch.device("cpu"))
    assert border_edges(result) > border_edges(mesh)
