"""Vertices of binary glTF 2.0 files, placed by their node transforms."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw
from udflow.cloud.formats.source import Source
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.srgb import linear_to_srgb8
from udflow.errors import InvalidCloud

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"VEC3": 3, "VEC4": 4}
# What would make the stored positions something else than positions.
_PACKED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
_MAX_DESCRIPTION = 4 * 1024 * 1024
_DAMAGE = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)


@dataclass(frozen=True)
class _Part:
    """One primitive of one node, in the frame of the scene; colors are linear, 0..1."""

    points: NDArray[np.float64]
    colors: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None


def read_glb(source: Source) -> PointCloud:
    """The vertices of all meshes of the scene, in the frame of the scene (Y is up in glTF).

    Colours and normals are kept where every part has them.

    Raises:
        InvalidCloud: a damaged or compressed file, or one without vertices.
    """
    document, binary = _chunks(source)
    try:
        parts = list(_Scene(source, document, binary).parts())
    except InvalidCloud:
        raise
    except _DAMAGE as error:
        raise source.fault("its description contradicts itself; export it again") from error
    if not parts:
        raise source.fault("the scene holds no vertices")
    colors = [part.colors for part in parts if part.colors is not None]
    normals = [part.normals for part in parts if part.normals is not None]
    raw = Raw(
        np.concatenate([part.points for part in parts]),
        linear_to_srgb8(np.concatenate(colors)) if len(colors) == len(parts) else None,
        np.concatenate(normals) if len(normals) == len(parts) else None,
    )
    return assemble(raw, format=source.format)


def _chunks(source: Source) -> tuple[dict[str, Any], bytes]:
    """The JSON description and the binary chunk."""
    source.take(4, "the header")
    version, length, json_length = np.frombuffer(source.take(12, "the header"), "<u4", 3).tolist()
    if version != 2 or length > source.size or source.take(4, "the header") != b"JSON":
        raise source.fault("the header is not that of binary glTF 2.0, or the file is truncated")
    if json_length > _MAX_DESCRIPTION:
        raise source.fault(f"the description has {json_length} bytes; at most 4 MiB are read")
    try:
        document = json.loads(source.take(json_length, "the description"))
    except (ValueError, RecursionError) as error:
        raise source.fault("the description is no readable JSON; export it again") from error
    if not isinstance(document, dict):
        raise source.fault("the description is no JSON object; export it again")
    binary = b""
    if source.remaining >= 8:
        size = int.from_bytes(source.take(4, "the binary chunk"), "little")
        if source.take(4, "the binary chunk") == b"BIN\0":
            binary = source.take(size, "the binary chunk")
    return document, binary


class _Scene:
    """The nodes, meshes and accessors of one document, every index and range checked."""

    def __init__(self, source: Source, document: dict[str, Any], binary: bytes) -> None:
        self._source = source
        self._document = document
        self._binary = binary
        packed = _PACKED & set(document.get("extensionsRequired", ()))
        if packed:
            raise source.fault(
                f"the meshes are compressed with {', '.join(sorted(packed))}, which is not read; "
                "export the file without compression"
            )

    def parts(self) -> Iterator[_Part]:
        """All primitives with their transforms applied."""
        total = 0
        for mesh, transform in self._placed_meshes():
            seen = set()
            for primitive in self._item("meshes", mesh)["primitives"]:
                attributes = primitive["attributes"]
                position = attributes.get("POSITION")
                if position is None or position in seen:  # parts may share their vertices
                    continue
                seen.add(position)
                total += self._count(position)
                self._source.require_expansion(total * 24, self._source.size)
                self._source.require_count(total)
                yield self._part(attributes, transform)

    def _part(self, attributes: dict[str, int], transform: NDArray[np.float64]) -> _Part:
        points = self._values(attributes["POSITION"])[:, :3].astype(np.float64)
        turn = transform[:3, :3]
        colors = normals = None
        if "COLOR_0" in attributes:
            colors = self._values(attributes["COLOR_0"])[:, :3].astype(np.float32)
        if "NORMAL" in attributes:
            # The cofactors turn normals as the inverse transpose does, without dividing.
            cofactors = np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]])
            turned = self._values(attributes["NORMAL"])[:, :3] @ cofactors.T
            length = np.linalg.norm(turned, axis=1, keepdims=True)
            normals = (turned / np.where(length > 0.0, length, 1.0)).astype(np.float32)
        for extra in (colors, normals):
            if extra is not None and len(extra) != len(points):
                raise IndexError
        return _Part(points @ turn.T + transform[:3, 3], colors, normals)

    def _placed_meshes(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Mesh numbers with the transforms of the nodes that show them."""
        nodes = self._document.get("nodes", [])
        scenes = self._document.get("scenes")
        if scenes:
            roots = self._item("scenes", self._document.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", ())}
            roots = [index for index in range(len(nodes)) if index not in children]
        stack = [(root, np.eye(4)) for root in roots]
        visits = 0
        while stack:
            index, above = stack.pop()
            visits += 1
            if visits > len(nodes):
                raise self._source.fault("a node is its own ancestor or has two; export it again")
            node = self._item("nodes", index)
            transform = above @ _local_transform(node)
            if "mesh" in node:
                yield node["mesh"], transform
            stack += [(child, transform) for child in node.get("children", ())]

    def _item(self, kind: str, index: Any) -> dict[str, Any]:
        items = self._document[kind]
        if type(index) is not int or not 0 <= index < len(items):
            raise IndexError
        item = items[index]
        if not isinstance(item, dict):
            raise TypeError
        return item

    def _count(self, accessor: Any) -> int:
        count = self._item("accessors", accessor)["count"]
        if type(count) is not int or count < 0:
            raise ValueError
        return count

    def _values(self, index: int) -> NDArray[np.float64]:
        """The values of an accessor, (count, 3 or 4), normalised whole numbers as fractions."""
        accessor = self._item("accessors", index)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise self._source.fault("sparse accessors are not read; export it without them")
        view = self._item("bufferViews", accessor["bufferView"])
        if view.get("buffer", 0) != 0 or "uri" in self._item("buffers", 0):
            raise self._source.fault("the data lie in another file; export one .glb file")
        dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
        width = _WIDTHS[accessor["type"]]
        stride = view.get("byteStride") or width * dtype.itemsize
        first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        shape = (self._count(index), width)
        last = first + max(shape[0] - 1, 0) * stride + width * dtype.itemsize
        if stride < width * dtype.itemsize or first < 0 or last > len(self._binary):
            raise self._source.fault(
                "refers to bytes that are not there; it is truncated or damaged"
            )
        values = np.ndarray(shape, dtype, self._binary, first, (stride, dtype.itemsize))
        if accessor.get("normalized") and dtype.kind in "iu":
            return values / float(np.iinfo(dtype).max)
        return values.astype(np.float64)


def _local_transform(node: dict[str, Any]) -> NDArray[np.float64]:
    """The (4, 4) matrix of a node, given whole or as translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    transform = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    transform[:3, :3] = np.array(rotation) * np.array(node.get("scale", (1.0, 1.0, 1.0)), float)
    transform[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return transform
