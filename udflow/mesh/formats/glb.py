"""Binary glTF 2.0: what viewers show, in single precision around a shifted origin."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.srgb import srgb8_to_linear
from udflow.mesh.mesh import Mesh

UpAxis = Literal["z", "y"]

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963
_GLTF_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
# A quarter turn about x takes (x, y, z) to (x, z, -y), as a quaternion x, y, z, w.
_Z_UP_TO_Y_UP = (-(0.5**0.5), 0.0, 0.0, 0.5**0.5)


@dataclass(frozen=True)
class _Accessor:
    """One array of the binary chunk. name: of the vertex attribute, "" for the indices."""

    name: str
    values: NDArray[Any]
    component: int
    type: str


def write_glb(file: BinaryIO, mesh: Mesh, *, up: UpAxis, shift: tuple[float, float, float]) -> None:
    """Write a mesh whose coordinates are already relative to `shift`.

    glTF is Y-up: for `up="z"` the node carries a rotation and the vertices stay as they are, so
    that they remain comparable with the other formats. `shift` and `up` are stated in double
    precision in the extras of asset and node. Colours are linear in glTF, and the material shows
    both sides, since the surface has no inside.
    """
    accessors = _accessors(mesh)
    document = json.dumps(_document(accessors, up, shift), separators=(",", ":")).encode("ascii")
    document += b" " * (-len(document) % 4)
    size = sum(accessor.values.nbytes for accessor in accessors)
    length = 12 + 8 + len(document) + 8 + size
    if length >= 2**32:
        raise ValueError(f"a GLB file holds at most 4 GiB but the mesh needs {length}; write PLY")
    file.write(_GLTF_MAGIC + _words(2, length) + _words(len(document)) + _JSON + document)
    file.write(_words(size) + _BIN)
    for accessor in accessors:
        file.write(accessor.values.tobytes())


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(4, "little") for value in values)


def _accessors(mesh: Mesh) -> list[_Accessor]:
    """All arrays; each takes a multiple of four bytes, so that all of them are aligned."""
    found = [
        _Accessor("POSITION", mesh.vertices.astype("<f4"), _FLOAT, "VEC3"),
        _Accessor("NORMAL", _vertex_normals(mesh), _FLOAT, "VEC3"),
    ]
    if mesh.colors is not None:
        found.append(_Accessor("COLOR_0", _linear_colors(mesh.colors), _USHORT, "VEC4"))
    found.append(_Accessor("", mesh.faces.astype("<u4").reshape(-1), _UINT, "SCALAR"))
    return found


def _linear_colors(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """sRGB (n, 3) to linear RGBA (n, 4); 16 bits, since 8 linear bits are too few in the dark."""
    light = np.full((len(colors), 4), 65535, "<u2")
    light[:, :3] = np.rint(srgb8_to_linear(colors) * 65535.0)
    return light


def _vertex_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Area-weighted unit normals (v, 3), +z where a vertex has no area around it."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    total = np.zeros((len(mesh.vertices), 3))
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(
                mesh.faces[:, corner], across[:, axis], minlength=len(total)
            )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    flat = length[:, 0] == 0.0
    normals = (total / np.where(length > 0.0, length, 1.0)).astype("<f4")
    normals[flat] = (0.0, 0.0, 1.0)
    return normals


def _document(
    accessors: list[_Accessor], up: UpAxis, shift: tuple[float, float, float]
) -> dict[str, Any]:
    extras = {"udflow": {"shift": list(shift), "up": up}}
    node: dict[str, Any] = {"name": "surface", "mesh": 0, "extras": extras}
    if up == "z":
        node["rotation"] = list(_Z_UP_TO_Y_UP)
    attributes = {a.name: i for i, a in enumerate(accessors) if a.name}
    primitive = {"attributes": attributes, "indices": len(accessors) - 1, "material": 0}
    surface = {"baseColorFactor": [1.0] * 4, "metallicFactor": 0.0, "roughnessFactor": 0.9}
    return {
        "asset": {"version": "2.0", "generator": "udflow", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"name": "surface", "primitives": [primitive]}],
        "materials": [{"name": "both sides", "doubleSided": True, "pbrMetallicRoughness": surface}],
        "accessors": [_described(i, a) for i, a in enumerate(accessors)],
        "bufferViews": _views(accessors),
        "buffers": [{"byteLength": sum(a.values.nbytes for a in accessors)}],
    }


def _described(index: int, accessor: _Accessor) -> dict[str, Any]:
    described: dict[str, Any] = {
        "bufferView": index,
        "componentType": accessor.component,
        "count": len(accessor.values),
        "type": accessor.type,
    }
    if accessor.name == "POSITION":  # required, and of the rounded values
        described["min"] = accessor.values.min(axis=0).astype(float).tolist()
        described["max"] = accessor.values.max(axis=0).astype(float).tolist()
    if accessor.name == "COLOR_0":
        described["normalized"] = True
    return described


def _views(accessors: list[_Accessor]) -> list[dict[str, Any]]:
    views = []
    offset = 0
    for accessor in accessors:
        target = _VERTEX_BUFFER if accessor.name else _INDEX_BUFFER
        size = accessor.values.nbytes
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": size, "target": target})
        offset += size
    return views
