"""Vertices of OBJ, STL, OFF and GLB files as point clouds."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

Read = Callable[[bytes], PointCloud]
CORNERS: list[list[float]] = [[0, 0, 0], [1, 0, 0], [0, 2, 0]]


def test_obj_ignores_everything_but_vertices(read: Read) -> None:
    text = (
        "# made by hand\nmtllib a.mtl\no part\nvt 0.5 0.5\nvn 0 0 1\n"
        "v 0 0 0\n  v\t1 0 0 1.0\nv 0 2 0\nf 1/1/1 2/1/1 3/1/1\n" + "f" + " 1 2 3" * 3000 + "\n"
    )
    cloud = read(text.encode())
    assert cloud.points.tolist() == CORNERS
    assert cloud.colors is None
    with pytest.raises(InvalidCloud, match="OBJ: line 2 holds 'b'"):
        read(b"v 1 2 3\nv 1 b 3\n")
    with pytest.raises(InvalidCloud, match="OBJ: line 2 has 3 columns where at least 4"):
        read(b"v 1 2 3\nv 1 2\n")


def test_off_variants(read: Read) -> None:
    body = "0 0 0{0}\n1 0 0{0}\n0 2 0{0}\n3 0 1 2\n"
    plain = read(("OFF\n# comment\n\n3 1 0\n" + body.format("")).encode())
    assert plain.points.tolist() == CORNERS
    both = read(("CNOFF 3 1 0\n" + body.format(" 0 0 1 255 128 0 255")).encode())
    assert both.normals is not None
    assert both.normals[0].tolist() == [0, 0, 1]
    assert both.colors is not None
    assert both.colors[0].tolist() == [255, 128, 0]
    for text, said in (
        ("OFF BINARY\n3 1 0\n", "save an ascii OFF file"),
        ("4OFF\n3 1 0\n" + body.format(" 1"), "is not read"),
        ("OFF\n2000000000 1 0\n" + body.format(""), "at most"),
        ("OFF\n90000000 1 0\n" + body.format(""), "truncated"),
        ("OFF\n-3 1 0\n" + body.format(""), "below zero"),
        ("OFF\n5 1 0\n" + body.format("        "), "rows before the end"),
    ):
        with pytest.raises(InvalidCloud, match=said):
            read(text.encode())


def test_stl_corners_become_distinct_vertices(read: Read) -> None:
    facet = struct.pack("<12fH", 0, 0, 1, *np.ravel(CORNERS), 0)
    # Binary files may begin with the word that marks ascii ones.
    cloud = read(b"solid but binary".ljust(80) + struct.pack("<I", 3) + facet * 3)
    assert cloud.points.tolist() == CORNERS
    text = "solid\nfacet normal 0 0 1\nouter loop\nvertex 1 2 x\n"
    with pytest.raises(InvalidCloud, match="line 4 holds 'x'"):
        read(text.encode())


def _glb(document: dict[str, Any] | bytes, binary: bytes = b"") -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return b"glTF" + struct.pack("<II", 2, length) + chunks


def _document(**changes: Any) -> dict[str, Any]:
    position = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [position],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    }
    return document | changes


BINARY = np.array(CORNERS, "<f4").tobytes()


def test_glb_nodes_are_applied_from_the_root_down(read: Read) -> None:
    half = 0.5**0.5
    nodes = [
        {"translation": [10, 0, 0], "children": [1, 2]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2]},  # x goes to y
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]},
        {"mesh": 0, "translation": [99, 99, 99]},  # in no scene
    ]
    cloud = read(_glb(_document(nodes=nodes), BINARY))
    expected = [[10, 0, 0], [10, 2, 0], [6, 0, 0], [10, 0, 5], [11, 0, 5], [10, 2, 5]]
    assert sorted(cloud.points.round(6).tolist()) == sorted(expected)


def test_glb_strided_and_normalised_values(read: Read) -> None:
    rows = np.zeros(3, [("p", "<f4", 3), ("c", "u1", 4)])
    rows["p"], rows["c"] = CORNERS, (255, 55, 0, 255)
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 0, "byteOffset": 12, "componentType": 5121, "count": 3, "type": "VEC4"},
    ]
    accessors[1]["normalized"] = True
    cloud = read(
        _glb(
            _document(
                accessors=accessors,
                meshes=[{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}}]}],
                bufferViews=[{"buffer": 0, "byteLength": 48, "byteStride": 16}],
            ),
            rows.tobytes(),
        )
    )
    assert cloud.points.tolist() == CORNERS
    assert cloud.colors is not None
    assert cloud.colors[0].tolist() == [255, 128, 0]  # linear light 55 / 255 is sRGB 128


ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
LOOP = [{"mesh": 0, "children": [1]}, {"children": [0]}]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_glb(_document(accessors=[ACCESSOR | {"count": 4}]), BINARY), "bytes that are not there"),
        (_glb(_document(accessors=[ACCESSOR | {"count": 2**31}]), BINARY), "which no scan does"),
        (_glb(_document(accessors=[ACCESSOR | {"count": -1}]), BINARY), "contradicts itself"),
        (_glb(_document(accessors=[ACCESSOR | {"byteOffset": -12}]), BINARY), "not there"),
        (_glb(_document(accessors=[ACCESSOR | {"sparse": {}}]), BINARY), "sparse"),
        (_glb(_document(accessors=[ACCESSOR | {"bufferView": -1}]), BINARY), "contradicts itself"),
        (_glb(_document(nodes=LOOP), BINARY), "its own ancestor"),
        (_glb(_document(scenes=[{"nodes": [0] * 9}]), BINARY), "its own ancestor"),
        (_glb(_document(nodes=[{"mesh": 7}]), BINARY), "contradicts itself"),
        (_glb(_document(nodes="many"), BINARY), "contradicts itself"),
        (_glb(_document(nodes=[{"mesh": 0, "matrix": [1]}]), BINARY), "contradicts itself"),
        (_glb(_document(nodes=[{}]), BINARY), "holds no vertices"),
        (_glb(_document(buffers=[{"uri": "file:///etc/passwd"}]), BINARY), "another file"),
        (_glb(_document(extensionsRequired=["KHR_draco_mesh_compression"])), "without compression"),
        (_glb(b"[" * 4000, BINARY), "no readable JSON"),
        (_glb(b"[]", BINARY), "no JSON object"),
        (_glb(_document(), BINARY)[:-10], "truncated"),
        (b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "binary glTF 2.0"),
    ],
)
def test_damaged_glb_is_refused_in_words(content: bytes, said: str, read: Read) -> None:
    with pytest.raises(InvalidCloud, match=said):
        read(content)


def test_vertices_shared_by_primitives_count_once(read: Read) -> None:
    part = {"attributes": {"POSITION": 0}}
    cloud = read(_glb(_document(meshes=[{"primitives": [part, part]}]), BINARY))
    assert cloud.points.tolist() == CORNERS


def test_glb_colors_are_kept_only_where_all_parts_have_them(read: Read) -> None:
    content = files.mesh("glb")
    assert read(content).colors is not None
    renamed = content.replace(b'"COLOR_0"', b'"_OLOR_0"')
    assert read(renamed).colors is None
