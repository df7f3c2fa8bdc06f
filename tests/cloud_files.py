"""Scans as bytes in every format that is read, written plainly by the formats' own rules."""

from __future__ import annotations

import io
import struct
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray

from udflow.mesh.export import MeshFormat, write_mesh
from udflow.mesh.mesh import Mesh

POINTS: NDArray[np.float32] = np.random.default_rng(7).normal(size=(400, 3)).astype(np.float32)
COLORS: NDArray[np.uint8] = np.random.default_rng(8).integers(1, 255, (400, 3)).astype(np.uint8)
_NORMALS = np.random.default_rng(9).normal(size=(400, 3))
NORMALS: NDArray[np.float32] = (_NORMALS / np.linalg.norm(_NORMALS, axis=1, keepdims=True)).astype(
    np.float32
)
UTM = np.array([512000.0, 5403000.0, 300.0])


def ply_header(format: str, *lines: str) -> bytes:
    return "\n".join(["ply", f"format {format} 1.0", *lines, "end_header", ""]).encode()


def vertex_lines(count: int, type: str = "float") -> list[str]:
    return [f"element vertex {count}", *(f"property {type} {axis}" for axis in "xyz")]


def ply(order: str = "<", points: NDArray[Any] = POINTS, tail: bytes = b"") -> bytes:
    """Binary PLY of the given coordinates, in their precision, with colours and normals."""
    format = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    type = {4: "float", 8: "double"}[points.itemsize]
    rows = np.empty(
        len(points),
        [("p", f"{order}f{points.itemsize}", 3), ("n", order + "f4", 3), ("c", "u1", 3)],
    )
    rows["p"], rows["n"], rows["c"] = points, NORMALS[: len(points)], COLORS[: len(points)]
    extra = [f"property float n{axis}" for axis in "xyz"]
    extra += [f"property uchar {name}" for name in ("red", "green", "blue")]
    return ply_header(format, *vertex_lines(len(points), type), *extra) + rows.tobytes() + tail


def ply_ascii() -> bytes:
    extra = [f"property uchar {name}" for name in ("red", "green", "blue")]
    faces = ["element face 2", "property list uchar int vertex_indices"]
    return (
        ply_header("ascii", *vertex_lines(len(POINTS)), *extra, *faces)
        + table(np.hstack([POINTS, COLORS]))
        + b"3 0 1 2\n4 0 1 2 3\n"
    )


def table(values: NDArray[Any], separator: str = " ") -> bytes:
    """Rows of numbers as text, shortest exact form."""
    rows = (separator.join(map(repr, row)) for row in values.astype(np.float64).tolist())
    return ("\n".join(rows) + "\n").encode()


def pcd(data: str, points: NDArray[np.float32] = POINTS) -> bytes:
    """PCD with a packed colour as float, as PCL writes it."""
    packed = COLORS.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
    rgb = packed[: len(points)].astype("<u4").view("<f4")
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\n"
        f"TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {data}\n"
    ).encode()
    rows = np.column_stack([points, rgb]).astype("<f4")
    if data == "ascii":
        return head + table(rows)
    if data == "binary":
        return head + rows.tobytes()
    body = np.ascontiguousarray(rows.T).tobytes()
    packed_body = lzf_compress(body)
    return head + struct.pack("<II", len(packed_body), len(body)) + packed_body


def lzf_compress(data: bytes) -> bytes:
    """A plain LZF compressor: the latest place of each three bytes, longest match, literals."""
    out = bytearray()
    literals = bytearray()
    latest: dict[bytes, int] = {}
    at = 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            piece = literals[start : start + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        literals.clear()

    while at < len(data):
        key = data[at : at + 3]
        found = latest.get(key, -1)
        latest[key] = at
        distance = at - found - 1
        if len(key) < 3 or found < 0 or distance >= 8192:
            literals.append(data[at])
            at += 1
            continue
        length = 3
        while (
            length < 264 and at + length < len(data) and data[found + length] == data[at + length]
        ):
            length += 1
        flush()
        short = min(length - 2, 7)
        out.append(short << 5 | distance >> 8)
        if short == 7:
            out.append(length - 9)
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def npy(array: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(compressed: bool = False, **arrays: Any) -> bytes:
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return file.getvalue()


def las(point_format: int, compressed: bool, points: NDArray[Any] = POINTS) -> bytes:
    """LAS in millimetres around the UTM offset, with 16-bit colours where the format has them."""
    version = "1.4" if point_format > 5 else "1.2"
    scan = laspy.create(point_format=point_format, file_version=version)
    scan.header.scales, scan.header.offsets = [0.001] * 3, UTM
    scan.x, scan.y, scan.z = (points.astype(np.float64) + UTM).T
    if "red" in scan.point_format.dimension_names:
        colors = np.resize(COLORS, points.shape).astype(np.uint16) * 257
        scan.red, scan.green, scan.blue = colors.T
    file = io.BytesIO()
    scan.write(file, do_compress=compressed)
    return file.getvalue()


def mesh(format: MeshFormat) -> bytes:
    """The points as vertices of triangles that use each of them."""
    faces = np.arange(399).reshape(-1, 3)
    faces = np.vstack([faces, [[399, 0, 1]]])
    file = io.BytesIO()
    write_mesh(Mesh(POINTS.astype(np.float64), faces, COLORS), file, format, up="y")
    return file.getvalue()


def stl_ascii() -> bytes:
    corner = "vertex {!r} {!r} {!r}\n"
    facets = [
        "facet normal 0 0 1\nouter loop\n"
        + "".join(corner.format(*p) for p in POINTS[i : i + 3].tolist())
        + "endloop\nendfacet\n"
        for i in range(398)
    ]
    return ("solid scan\n" + "".join(facets) + "endsolid scan\n").encode()


def off() -> bytes:
    return b"COFF\n# a comment\n400 1 0\n" + table(np.hstack([POINTS, COLORS])) + b"3 0 1 2\n"


def samples() -> dict[str, bytes]:
    """One well-formed file of every kind; each holds POINTS, in its order except STL."""
    return {
        "ply-little": ply("<"),
        "ply-big": ply(">", POINTS.astype(np.float64)),
        "ply-ascii": ply_ascii(),
        "text-csv": b"x,y,z,nx,ny,nz\n" + table(np.hstack([POINTS, NORMALS]), " , "),
        "text-pts": b"400\n" + table(np.hstack([POINTS, np.full((400, 1), -7), COLORS])),
        "npy": npy(POINTS),
        "npz": npz(points=POINTS, colors=COLORS),
        "npz-compressed": npz(compressed=True, points=POINTS),
        "pcd-ascii": pcd("ascii"),
        "pcd-binary": pcd("binary"),
        "pcd-compressed": pcd("binary_compressed"),
        "las": las(3, compressed=False),
        "laz-pointwise": las(2, compressed=True),
        "laz-layered": las(7, compressed=True),
        "glb": mesh("glb"),
        "obj": mesh("obj"),
        "stl": mesh("stl"),
        "stl-ascii": stl_ascii(),
        "off": off(),
    }
