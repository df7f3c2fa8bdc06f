"""Meshes from files, for measuring against a reference."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from udflow.cloud.distinct import distinct_labels
from udflow.cloud.formats import read_cloud
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud
from udflow.mesh.formats.obj_faces import read_obj_faces
from udflow.mesh.mesh import Mesh

_FORMATS = ("ply", "obj", "stl", "off", "glb")
# Corners of an STL file that belong together may differ by rounding.
_WELD = 1e-6


def read_mesh(path: Path) -> Mesh:
    """The triangles in a PLY, OBJ, STL, OFF or GLB file, in the frame of the file.

    Vertices of PLY, OBJ, OFF and GLB stay as they are in the file, shared or not. STL stores every
    corner of every triangle: corners closer than 1e-6 of the extent become one vertex. Node
    transforms of GLB are applied. Polygons become fans of triangles.

    Raises:
        UnknownFormat, InvalidCloud: what `read_cloud` refuses, a format without triangles, or a
            file without any.
        OSError: the file cannot be opened.
    """
    cloud = read_cloud(path)  # checks the file more strictly than trimesh does
    if cloud.format not in _FORMATS:
        raise InvalidCloud(
            f"{cloud.format.upper()} holds points but no triangles; give a mesh as "
            f"{', '.join(_FORMATS).upper()}"
        )
    if cloud.dropped:
        raise InvalidCloud(f"the mesh has {cloud.dropped} vertices with undefined coordinates")
    if cloud.format == "obj":
        return _checked(Mesh(cloud.points, read_obj_faces(path), cloud.colors))
    vertices, faces = _by_trimesh(path, cloud.format)
    if cloud.format == "stl":
        vertices, faces = weld(vertices, faces)
    return _checked(Mesh(vertices, faces, _colors_of(cloud, vertices)))


def weld(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], tolerance: float = _WELD
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Make vertices closer than `tolerance` of the extent one, and drop faces that collapse.

    Of each group of vertices the first stays where it is.
    """
    same = distinct_labels(vertices)
    unique = vertices[same.first]
    reach = tolerance * float(np.ptp(vertices, axis=0).max())
    pairs = cKDTree(unique).query_pairs(reach, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(len(unique), len(unique)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    welded = group[same.label][faces].astype(np.int64)
    a, b, c = welded.T
    return unique[first], welded[(a != b) & (b != c) & (c != a)]


def _by_trimesh(path: Path, format: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    # Takes a third of a second to import, which point clouds need not pay.
    import trimesh

    try:
        # As bytes, so that nothing the file refers to is opened.
        scene = trimesh.load_scene(
            io.BytesIO(path.read_bytes()), file_type=format, process=False, skip_materials=True
        )
        return _joined(scene)
    except Exception as error:  # trimesh's loaders have no common base of what they raise
        raise InvalidCloud(
            f"{format.upper()}: the triangles cannot be read; export the mesh again"
        ) from error


def _joined(scene: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The triangles of all nodes in the frame of the scene.

    trimesh joins them too, but copies their textures for it, which asks for an image library.
    """
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        found = scene.geometry[name]
        if not hasattr(found, "faces"):
            continue
        placed = np.asarray(found.vertices, np.float64)
        if not np.array_equal(transform, np.eye(4)):
            placed = placed @ transform[:3, :3].T + transform[:3, 3]
        vertices.append(placed)
        faces.append(np.asarray(found.faces, np.int64) + count)
        count += len(placed)
    return np.concatenate(vertices), np.concatenate(faces)


def _colors_of(cloud: PointCloud, vertices: NDArray[np.float64]) -> NDArray[np.uint8] | None:
    """The colours the strict reader found, where its vertices are these."""
    return cloud.colors if np.array_equal(cloud.points, vertices) else None


def _checked(mesh: Mesh) -> Mesh:
    if len(mesh.faces) == 0:
        raise InvalidCloud("the file holds points but no triangles; give a mesh")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise InvalidCloud("a triangle refers to a vertex that is not there; the file is damaged")
    return mesh
