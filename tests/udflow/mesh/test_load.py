"""Meshes from files: whatever a scene holds beside its triangles, they are read."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from udflow.mesh.load import read_mesh

TEXTURED = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float texture_u
property float texture_v
element face 2
property list uchar int vertex_indices
end_header
0 0 0 0 0
1 0 0 1 0
1 1 0 1 1
0 1 0 0 1
3 0 1 2
3 0 2 3
"""


def test_texture_coordinates_ask_for_no_image_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    path = tmp_path / "textured.ply"
    path.write_bytes(TEXTURED)
    mesh = read_mesh(path)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(mesh.vertices[2], [1, 1, 0])


def test_every_node_of_a_scene_stands_in_its_place(tmp_path: Path) -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    away = np.eye(4)
    away[:3, 3] = (5.0, 0.0, 0.0)
    scene = trimesh.Scene()
    scene.add_geometry(box, node_name="here")
    scene.add_geometry(box, node_name="there", transform=away)
    path = tmp_path / "two.glb"
    path.write_bytes(scene.export(file_type="glb"))
    mesh = read_mesh(path)
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.5, -0.5, -0.5])
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [5.5, 0.5, 0.5])
    corners = mesh.vertices[mesh.faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    np.testing.assert_allclose(areas.sum(), 12.0)
