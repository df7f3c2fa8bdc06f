"""What is written reloads elsewhere, in the right frame, to the last micrometre."""

from __future__ import annotations

import io
import json
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from udflow.cloud.formats import read_cloud
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import EmptySurface, InvalidCloud
from udflow.mesh.export import MESH_FORMATS, MeshFormat, write_mesh, write_points
from udflow.mesh.formats.numerals import decimals_for, fixed_point, lines, whole_numbers
from udflow.mesh.load import read_mesh, weld
from udflow.mesh.mesh import Mesh

UTM = (512000.0, 5403000.0, 300.0)
DATA = Path(__file__).resolve().parents[3] / "../shared/data"


def _sheet(n: int = 30, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A curved open sheet of about 10 x 10 units, coloured."""
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    vertices = np.stack([10 * u, 10 * v, np.sin(5 * u) * np.cos(7 * v)], axis=-1).reshape(-1, 3)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    colors = np.random.default_rng(0).integers(0, 256, (n * n, 3)).astype(np.uint8)
    return Mesh(vertices + np.asarray(offset), faces, colors)


def _reloaded(content: bytes, format: str) -> Any:
    return trimesh.load(io.BytesIO(content), file_type=format, process=False, force="mesh")


def _written(mesh: Mesh, format: MeshFormat, **options: Any) -> bytes:
    file = io.BytesIO()
    write_mesh(mesh, file, format, **options)
    return file.getvalue()


@pytest.mark.parametrize("format", ["ply", "obj"])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_ply_and_obj_keep_frame_faces_and_colors(
    format: MeshFormat, offset: tuple[float, float, float]
) -> None:
    mesh = _sheet(offset=offset)
    found = _reloaded(_written(mesh, format), format)
    np.testing.assert_allclose(found.vertices, mesh.vertices, rtol=0, atol=2e-9)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    np.testing.assert_array_equal(found.visual.vertex_colors[:, :3], mesh.colors)


def test_the_header_of_a_ply_file() -> None:
    head = _written(_sheet(n=2), "ply").split(b"end_header\n")[0].decode()
    assert head == (
        "ply\nformat binary_little_endian 1.0\ncomment udflow\nelement vertex 4\n"
        "property double x\nproperty double y\nproperty double z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 2\nproperty list uchar int vertex_indices\n"
    )


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_stl_states_its_shift(offset: tuple[float, float, float]) -> None:
    mesh = _sheet(offset=offset)
    file = io.BytesIO()
    shift = write_mesh(mesh, file, "stl")
    content = file.getvalue()
    assert shift == ((512000.0, 5403000.0, 300.0) if any(offset) else (0.0, 0.0, 0.0))
    expected = "udflow shift 512000.0 5403000.0 300.0" if any(offset) else "udflow"
    assert content[:80].decode().rstrip() == expected
    found = _reloaded(content, "stl")
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    np.testing.assert_allclose(found.vertices + np.asarray(shift), corners, rtol=0, atol=1e-6)
    a, b, c = (corners[i::3] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stored = np.frombuffer(content[84:], np.dtype([("n", "<f4", 3), ("rest", "V38")]))["n"]
    np.testing.assert_allclose(stored, normals, atol=1e-5)


def _glb_parts(content: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, length, size = struct.unpack_from("<4sIII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    assert size % 4 == 0
    document = json.loads(content[20 : 20 + size])
    return document, content[20 + size + 8 :]


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_glb_is_y_up_local_and_states_its_shift(offset: tuple[float, float, float]) -> None:
    mesh = _sheet(offset=offset)
    file = io.BytesIO()
    shift = np.asarray(write_mesh(mesh, file, "glb"))
    document, _ = _glb_parts(file.getvalue())
    stated = {"shift": shift.tolist(), "up": "z"}
    assert document["asset"]["extras"]["udflow"] == stated
    assert document["nodes"][0]["extras"]["udflow"] == stated
    assert document["materials"][0]["doubleSided"] is True
    found = _reloaded(file.getvalue(), "glb")
    x, y, z = (mesh.vertices - shift).T
    np.testing.assert_allclose(found.vertices, np.stack([x, z, -y], axis=1), rtol=0, atol=2e-6)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    turned = _reloaded(_written(mesh, "glb", up="y"), "glb")
    np.testing.assert_allclose(turned.vertices, mesh.vertices - shift, rtol=0, atol=2e-6)


def test_glb_buffers_bounds_and_normals() -> None:
    mesh = _sheet()
    document, binary = _glb_parts(_written(mesh, "glb"))
    assert document["buffers"] == [{"byteLength": len(binary)}]
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    views, accessors = document["bufferViews"], document["accessors"]
    assert all(view["byteOffset"] % 4 == 0 for view in views)
    assert views[-1]["byteOffset"] + views[-1]["byteLength"] == len(binary)
    position = accessors[attributes["POSITION"]]
    single = mesh.vertices.astype(np.float32)
    assert position["min"] == single.min(axis=0).tolist()
    assert position["max"] == single.max(axis=0).tolist()
    view = views[accessors[attributes["NORMAL"]]["bufferView"]]
    normals = np.frombuffer(binary, "<f4", len(single) * 3, view["byteOffset"]).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    expected = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals
    assert (np.abs((normals * expected).sum(axis=1)) > 0.99).all()


def test_glb_colors_are_linear() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), np.array([[0, 128, 255]] * 3, np.uint8))
    document, binary = _glb_parts(_written(mesh, "glb"))
    index = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    accessor = document["accessors"][index]
    assert (accessor["componentType"], accessor["normalized"]) == (5123, True)
    offset = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    stored = np.frombuffer(binary, "<u2", 4, offset) / 65535
    np.testing.assert_allclose(stored, [0.0, 0.2158605, 1.0, 1.0], atol=1e-5)


def test_vertices_without_a_face_do_not_spoil_the_normals() -> None:
    mesh = Mesh(np.vstack([np.eye(3), [[9.0, 9.0, 9.0]]]), np.array([[0, 1, 2], [0, 0, 1]]))
    document, binary = _glb_parts(_written(mesh, "glb"))
    offset = document["bufferViews"][1]["byteOffset"]
    normals = np.frombuffer(binary, "<f4", 12, offset).reshape(4, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("format", MESH_FORMATS)
def test_a_shift_of_the_callers_choice_is_applied_and_stated(format: MeshFormat) -> None:
    mesh = _sheet(offset=(100.0, 200.0, 300.0))
    content = _written(mesh, format, shift=(100.0, 200.0, 300.0), up="y")
    found = _reloaded(content, format)
    np.testing.assert_allclose(
        found.bounds[0], (mesh.vertices.min(axis=0) - (100, 200, 300)), atol=1e-6
    )
    assert b"100.0" in content[:2000]
    assert b"shift" in content[:2000]


def test_paths_suffixes_and_refusals(tmp_path: Path) -> None:
    mesh = _sheet(n=3)
    for format in MESH_FORMATS:
        path = tmp_path / f"out.{format.upper()}"
        write_mesh(mesh, path)
        assert path.read_bytes() == _written(mesh, format)
    with pytest.raises(ValueError, match="unknown mesh format 'fbx'; choose one of: ply, glb"):
        write_mesh(mesh, tmp_path / "out.fbx")
    with pytest.raises(ValueError, match="unknown mesh format None"):
        write_mesh(mesh, io.BytesIO())
    with pytest.raises(EmptySurface, match="no triangles"):
        write_mesh(Mesh(mesh.vertices, np.empty((0, 3), np.int64)), tmp_path / "out.ply")
    assert not (tmp_path / "out.ply").exists()


@pytest.mark.parametrize("extras", [False, True])
def test_points_come_back_as_they_were(extras: bool, tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    points = generator.normal(size=(500, 3)) + UTM
    colors = generator.integers(1, 255, (500, 3)).astype(np.uint8)
    normals = generator.normal(size=(500, 3)).astype(np.float32)
    cloud = PointCloud(points, colors, normals) if extras else PointCloud(points)
    write_points(cloud, tmp_path / "points.ply")
    found = read_cloud(tmp_path / "points.ply")
    np.testing.assert_array_equal(found.points, points)
    if extras:
        np.testing.assert_array_equal(found.colors, colors)
        np.testing.assert_array_equal(found.normals, normals)
    else:
        assert (found.colors, found.normals) == (None, None)


@pytest.mark.parametrize("format", MESH_FORMATS)
def test_read_mesh_gives_back_what_was_written(format: MeshFormat, tmp_path: Path) -> None:
    mesh = _sheet()
    path = tmp_path / "mesh"
    path.write_bytes(_written(mesh, format, up="y"))
    found = read_mesh(path)
    assert found.vertices.shape == mesh.vertices.shape
    np.testing.assert_allclose(
        found.vertices[found.faces], mesh.vertices[mesh.faces], rtol=0, atol=1e-6
    )
    if format in ("ply", "obj"):
        np.testing.assert_array_equal(found.colors, mesh.colors)


@pytest.mark.parametrize(
    ("name", "vertices", "faces"),
    [
        ("closed/spot.obj", 2930, 5856),  # has texture seams
        ("cad/featuretype.stl", 1722, 3476),  # corners differ by rounding
        ("cad/adis16480.stl", 3672, 7436),
        ("cad/tray_bottom.stl", 2216, 4520),
        ("layered/cycloidal.ply", 21384, 43368),
    ],
)
def test_real_meshes_have_the_size_their_makers_say(name: str, vertices: int, faces: int) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"needs the real file {name} in ../shared/data, which is not here")
    mesh = read_mesh(path)
    assert (len(mesh.vertices), len(mesh.faces)) == (vertices, faces)


def test_obj_polygons_and_texture_seams(tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nf 1/1 2/2 3/1 4/2\n"
        "v 0 0 1\nf -1//1 -5 2/2/2 # back from here\n"
    )
    mesh = read_mesh(path)
    assert len(mesh.vertices) == 5
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 0, 1]]


@pytest.mark.parametrize(
    ("face", "said"),
    [
        ("f 1 2 9", "not there"),
        ("f 1 2 -9", "not there"),
        ("f 1 2", "line 4 is no face"),
        ("f 1 2 0", "line 4 is no face"),
        ("f 1 2 x", "line 4 is no face"),
        ("f 1 2 " + "9" * 30, "line 4 is no face"),
        ("# f 1 2 3", "no triangles"),
    ],
)
def test_faces_that_make_no_sense(face: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")
    with pytest.raises(InvalidCloud, match=said):
        read_mesh(path)


def test_point_clouds_are_no_meshes(tmp_path: Path) -> None:
    path = tmp_path / "cloud"
    path.write_bytes(b"1 2 3\n4 5 6\n")
    with pytest.raises(InvalidCloud, match="TEXT holds points but no triangles"):
        read_mesh(path)
    write_points(PointCloud(np.eye(3)), path)
    with pytest.raises(InvalidCloud, match="no triangles"):
        read_mesh(path)
    path.write_bytes(_written(_sheet(), "ply")[:-5])
    with pytest.raises(InvalidCloud, match="truncated"):
        read_mesh(path)


def test_corners_of_an_stl_file_that_differ_by_rounding_are_one(tmp_path: Path) -> None:
    mesh = _sheet()
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-1e-7, 1e-7, corners.shape)
    loose = np.arange(len(corners)).reshape(-1, 3)
    vertices, faces = weld(corners, loose)
    assert len(vertices) == len(mesh.vertices)
    np.testing.assert_allclose(vertices[faces], mesh.vertices[mesh.faces], atol=1e-6)
    _, collapsed = weld(np.array([[0.0, 0, 0], [1e-9, 0, 0], [1, 0, 0]]), np.array([[0, 1, 2]]))
    assert len(collapsed) == 0


@given(
    st.lists(st.tuples(*[st.floats(-1e7, 1e7, allow_subnormal=False)] * 3), min_size=1, max_size=20)
)
def test_decimal_text_is_true_to_sixteen_digits(rows: list[tuple[float, float, float]]) -> None:
    values = np.array(rows)
    decimals = decimals_for(values)
    if decimals is None:
        assert np.abs(values).max() < 1e-6
        return
    text = lines(b"v", fixed_point(values, decimals)).decode()
    found = np.array([[float(word) for word in line.split()[1:]] for line in text.splitlines()])
    np.testing.assert_allclose(found, values, rtol=0, atol=2e-15 * np.abs(values).max())


def test_decimal_text_by_hand() -> None:
    values = np.array([[0.0, -1.5, 120.25], [-1e-9, -0.0, -100.0]])
    assert lines(b"v", fixed_point(values, 4)) == b"v 0.0 -1.5 120.25\nv 0.0 0.0 -100.0\n"
    assert lines(b"f", whole_numbers(np.array([[1, 20, 300], [0, 12345, 6]]))) == (
        b"f 1 20 300\nf 0 12345 6\n"
    )


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e20])
def test_obj_of_any_size(scale: float) -> None:
    mesh = Mesh(_sheet().vertices * scale, _sheet().faces, _sheet().colors)
    found = _reloaded(_written(mesh, "obj"), "obj")
    np.testing.assert_allclose(found.vertices, mesh.vertices, rtol=0, atol=1e-14 * 10 * scale)


@pytest.mark.parametrize("format", MESH_FORMATS)
def test_three_hundred_thousand_vertices_take_about_a_second(format: MeshFormat) -> None:
    mesh = _sheet(n=550)
    started = time.process_time()
    _written(mesh, format)
    assert time.process_time() - started < 4.0
