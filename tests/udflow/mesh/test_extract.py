"""Extraction from exact fields: the topology must be that of the shape."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from shapes import Cube, Hemisphere, MoebiusStrip, Shape, Sphere, Torus, TwoSheets

from udflow.config import ExtractConfig
from udflow.mesh.extract import extract
from udflow.mesh.mesh import Mesh
from udflow.mesh.topology import edges_of, parts

RESOLUTION = 64
VOXEL = 1.0 / RESOLUTION


def extracted(shape: Shape, resolution: int = RESOLUTION) -> Mesh:
    return extract(shape, shape.sample(20_000), ExtractConfig(resolution=resolution))


def border_loops(faces: np.ndarray) -> int:
    edges = edges_of(faces)
    border = edges.ends[edges.count == 1]
    if len(border) == 0:
        return 0
    vertices, flat = np.unique(border, return_inverse=True)
    return len(np.unique(parts(flat.reshape(-1, 2), len(vertices))))


def euler_number(mesh: Mesh) -> int:
    return len(mesh.vertices) - len(edges_of(mesh.faces).ends) + len(mesh.faces)


def components(mesh: Mesh) -> int:
    return len(np.unique(parts(edges_of(mesh.faces).ends, len(mesh.vertices))))


@pytest.mark.parametrize(
    "shape",
    [Sphere(), Torus(), Cube(), Hemisphere(), MoebiusStrip(), TwoSheets(gap=2.5 * VOXEL)],
    ids=lambda shape: type(shape).__name__,
)
def test_topology_and_place(shape: Shape) -> None:
    mesh = extracted(shape)
    assert components(mesh) == shape.components
    assert border_loops(mesh.faces) == shape.loops
    assert euler_number(mesh) == shape.euler
    off = shape.distance(torch.from_numpy(mesh.vertices))
    assert off.max() < 1e-4  # a sliver of the strip is a fold
    assert off.quantile(0.99) < 1e-6


@pytest.mark.parametrize("shape", [Sphere(), Torus(), Cube()], ids=lambda s: type(s).__name__)
def test_closed_shapes_are_watertight_and_face_outwards(shape: Shape) -> None:
    mesh = extracted(shape)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    exact = {Sphere: np.pi / 6, Torus: 2 * np.pi**2 * 0.35 * 0.15**2, Cube: 1.0}[type(shape)]
    assert solid.volume == pytest.approx(exact, rel=0.01)


def test_same_input_gives_the_same_bytes() -> None:
    one, two = extracted(Torus()), extracted(Torus())
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.faces.tobytes() == two.faces.tobytes()
