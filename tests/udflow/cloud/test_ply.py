"""PLY: what stands around the vertices, and headers that do not tell the truth."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

Read = Callable[[bytes], PointCloud]
FACES = ["element face 2", "property list uchar int vertex_indices"]


def _vertices(order: str = "<") -> bytes:
    return files.POINTS.astype(order + "f4").tobytes()


def _binary(*lines: str) -> bytes:
    return files.ply_header("binary_little_endian", *lines)


def test_faces_after_the_vertices_are_skipped(read: Read) -> None:
    head = _binary(*files.vertex_lines(400), *FACES)
    for faces in (b"\3" + bytes(12) + b"\3" + bytes(12), b"\3" + bytes(12) + b"\5" + bytes(20)):
        cloud = read(head + _vertices() + faces)
        np.testing.assert_array_equal(cloud.points, files.POINTS)
        assert cloud.warnings == ()


def test_elements_before_the_vertices_are_skipped(read: Read) -> None:
    grid = [
        "element camera 1",
        "property double focal",
        "element range_grid 3",
        "property list uchar short vertex_indices",
        "property float confidence",
    ]
    rows = b"\0" + b"conf" + b"\1ab" + b"conf" + b"\2abcd" + b"conf"
    cloud = read(_binary(*grid, *files.vertex_lines(400)) + bytes(8) + rows + _vertices())
    np.testing.assert_array_equal(cloud.points, files.POINTS)


def test_lists_inside_the_vertices_are_skipped(read: Read) -> None:
    lines = ["element vertex 400", "property float x", "property list uchar short seen_by"]
    lines += ["property float y", "property float z"]
    body = b"".join(
        struct.pack("<fB", x, i % 3) + bytes(2 * (i % 3)) + struct.pack("<ff", y, z)
        for i, (x, y, z) in enumerate(files.POINTS.tolist())
    )
    np.testing.assert_array_equal(read(_binary(*lines) + body).points, files.POINTS)
    text = "".join(
        f"{x!r} {i % 3} {'7 ' * (i % 3)}{y!r} {z!r}\n"
        for i, (x, y, z) in enumerate(files.POINTS.tolist())
    )
    cloud = read(files.ply_header("ascii", *lines) + text.encode())
    np.testing.assert_array_equal(cloud.points, files.POINTS)


def test_ascii_elements_before_and_blank_lines(read: Read) -> None:
    head = files.ply_header("ascii", *FACES, *files.vertex_lines(400))
    body = b"3 0 1 2\n\n4 0 1 2 3\n" + files.table(files.POINTS).replace(b"\n", b"\r\n")
    np.testing.assert_array_equal(read(head + body).points, files.POINTS)


def test_integer_coordinates_and_float_colors(read: Read) -> None:
    lines = ["element vertex 2", *(f"property short {a}" for a in "xyz")]
    lines += [f"property float {c}" for c in ("red", "green", "blue")]
    body = struct.pack("<hhhfff", 1, -2, 3, 0.0, 0.5, 1.0)
    body += struct.pack("<hhhfff", 4, 5, 6, 1.0, 0.25, 0.0)
    cloud = read(_binary(*lines) + body)
    assert cloud.points.tolist() == [[1.0, -2.0, 3.0], [4.0, 5.0, 6.0]]
    assert cloud.colors is not None
    assert cloud.colors.tolist() == [[0, 128, 255], [255, 64, 0]]


def test_dark_whole_colors_are_not_taken_for_fractions(read: Read) -> None:
    lines = [*files.vertex_lines(2), *(f"property uchar {c}" for c in ("red", "green", "blue"))]
    cloud = read(files.ply_header("ascii", *lines) + b"1 2 3 0 1 0\n4 5 6 1 1 1\n")
    assert cloud.colors is not None
    assert cloud.colors.tolist() == [[0, 1, 0], [1, 1, 1]]


def test_colors_outside_every_scale_are_ignored_with_a_warning(read: Read) -> None:
    lines = [*files.vertex_lines(2), *(f"property float {c}" for c in ("red", "green", "blue"))]
    cloud = read(files.ply_header("ascii", *lines) + b"1 2 3 0 -1 0\n4 5 6 1 1 1\n")
    assert cloud.colors is None
    assert "colours were ignored" in cloud.warnings[0]


def test_trailing_bytes_are_a_warning(read: Read) -> None:
    cloud = read(files.ply(tail=b"xyz"))
    assert cloud.warnings == ("3 bytes after the end of the data were ignored",)


@pytest.mark.parametrize(
    ("lines", "body", "said"),
    [
        (files.vertex_lines(2**31), b"12345", "claims 2147483648 points"),
        (files.vertex_lines(90_000_000), b"12345", "truncated"),
        (["element vertex -1"], b"", "below zero"),
        (["element vertex 9" + "9" * 40], b"", "no whole number"),
        (["element vertex 1.5"], b"", "no whole number"),
        (files.vertex_lines(0), b"", "holds no points"),
        (files.vertex_lines(401), _vertices(), "truncated"),
        ([*files.vertex_lines(400), *FACES], _vertices() + b"\3" + bytes(12), "truncated"),
        (["element face 100000000", *FACES[1:], *files.vertex_lines(1)], bytes(50), "truncated"),
        ([*files.vertex_lines(400), "element face 2147483647", *FACES[1:]], _vertices(), "trunc"),
        (["element f 1", "property list char int v", *files.vertex_lines(1)], b"\xff" * 13, "-1 e"),
        (["element face 1", "property list float int v"], b"", "length is a fraction"),
        (["element vertex 1", "property float x", "property float y"], bytes(8), "x, y and z"),
        (["element vertex 1", "property float128 x"], b"", "unknown type 'float128'"),
        (["element vertex"], b"", "damaged element line"),
        (["property float x"], b"", "before the first element"),
        (["element face 1"], b"", "no vertex element"),
        (["elephant 3"], b"", "no PLY keyword"),
    ],
)  # fmt: skip
def test_false_headers_are_refused_in_words_and_at_once(
    lines: list[str], body: bytes, said: str, read: Read
) -> None:
    started = time.process_time()
    with pytest.raises(InvalidCloud, match=said):
        read(_binary(*lines) + body)
    assert time.process_time() - started < 0.5


def test_headers_without_end_or_format(read: Read) -> None:
    with pytest.raises(InvalidCloud, match="ends inside its header"):
        read(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(InvalidCloud, match="no format line"):
        read(b"ply\nelement vertex 3\nend_header\n")
    with pytest.raises(InvalidCloud, match="unknown format 'binary_middle_endian"):
        read(files.ply_header("binary_middle_endian"))
    with pytest.raises(InvalidCloud, match="longer than"):
        read(b"ply\n" + b"comment again\n" * 10_000 + b"end_header\n")
    with pytest.raises(InvalidCloud, match="a line over 4096 bytes"):
        read(b"ply\ncomment " + b"x" * 5000 + b"\nend_header\n")


def test_ascii_rows_that_do_not_fit_are_named(read: Read) -> None:
    head = files.ply_header("ascii", *files.vertex_lines(3))
    with pytest.raises(InvalidCloud, match="line 9 holds 'two' where a number belongs"):
        read(head + b"1 2 3\n1 two 3\n1 2 3\n")
    with pytest.raises(InvalidCloud, match="line 10 has 2 columns"):
        read(head + b"1.5 2.5 3.5\n\n1 2\n1 2 3\n")
    with pytest.raises(InvalidCloud, match="ends 1 rows before the end"):
        read(head + b"1.25 2.25 3.25\n1.25 2.25 3.25\n")


@pytest.mark.parametrize("precision", ["f4", "f8"])
@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_the_wrong_byte_order_is_recognised(precision: str, scale: float, read: Read) -> None:
    type = {"f4": "float", "f8": "double"}[precision]
    head = files.ply_header("binary_big_endian", *files.vertex_lines(400, type))
    for points in (files.POINTS * scale, np.rint(files.POINTS * scale + 2)):
        with pytest.raises(InvalidCloud, match="Wrong byte order"):
            read(head + points.astype("<" + precision).tobytes())


def test_a_flat_rounded_plane_is_not_taken_for_the_wrong_byte_order(read: Read) -> None:
    flat = files.POINTS.astype(np.float64)
    flat[:, 2] = 1e-17 * flat[:, 0]
    np.testing.assert_array_equal(read(files.ply("<", flat)).points, flat)
