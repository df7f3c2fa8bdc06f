"""LAS and LAZ: scaled whole numbers, 16-bit colours, and headers that lie."""

from __future__ import annotations

import struct
from collections.abc import Callable

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

Read = Callable[[bytes], PointCloud]


@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
@pytest.mark.parametrize("compressed", [False, True])
def test_point_formats(point_format: int, compressed: bool, read: Read) -> None:
    cloud = read(files.las(point_format, compressed))
    np.testing.assert_allclose(
        cloud.points, files.POINTS.astype(np.float64) + files.UTM, rtol=0, atol=0.0006
    )
    if point_format in (2, 3, 7, 8):
        np.testing.assert_array_equal(cloud.colors, files.COLORS)
    else:
        assert cloud.colors is None


@pytest.mark.parametrize("point_format", [3, 7])
def test_several_chunks(point_format: int, read: Read) -> None:
    points = np.random.default_rng(0).normal(size=(120_000, 3)).astype(np.float32)
    cloud = read(files.las(point_format, compressed=True, points=points))
    np.testing.assert_allclose(
        cloud.points, points.astype(np.float64) + files.UTM, rtol=0, atol=0.0006
    )


def _patched(content: bytes, at: int, format: str, value: float) -> bytes:
    return content[:at] + struct.pack(format, value) + content[at + struct.calcsize(format) :]


@pytest.mark.parametrize(
    ("at", "format", "value", "said"),
    [
        (107, "<I", 2**31, "claims 2147483648 points"),
        (107, "<I", 401, "truncated"),
        (107, "<I", 0, "holds no points"),
        (96, "<I", 2**31, "contradicts itself"),
        (94, "<H", 9, "contradicts itself"),
        (104, "<B", 63, "unknown point format 63"),
        (105, "<H", 5, "records of 5 bytes"),
        (131, "<d", float("nan"), "scale or offset"),
        (139, "<d", 0.0, "scale or offset"),
    ],
)
def test_false_headers_are_refused_in_words(
    at: int, format: str, value: float, said: str, read: Read
) -> None:
    with pytest.raises(InvalidCloud, match=said):
        read(_patched(files.las(3, compressed=False), at, format, value))


def test_truncated_files(read: Read) -> None:
    for compressed in (False, True):
        whole = files.las(7, compressed)
        for size in (50, 200, 380, len(whole) // 2, len(whole) - 30):
            with pytest.raises(InvalidCloud):
                read(whole[:size])


def test_a_layer_that_claims_gigabytes_is_refused_before_it_is_allocated(read: Read) -> None:
    content = files.las(7, compressed=True)
    (first,) = struct.unpack_from("<I", content, 96)
    (record_bytes,) = struct.unpack_from("<H", content, 105)
    sizes = first + 8 + record_bytes + 4  # table offset, a whole point, the count of the chunk
    for layer in range(10):
        with pytest.raises(InvalidCloud, match="compressed points need"):
            read(_patched(content, sizes + 4 * layer, "<I", 4_000_000_000))


def test_a_chunk_table_that_claims_billions_is_refused(read: Read) -> None:
    content = files.las(2, compressed=True)
    (first,) = struct.unpack_from("<I", content, 96)
    (table,) = struct.unpack_from("<q", content, first)
    with pytest.raises(InvalidCloud, match="chunk table claims 4000000000 chunks"):
        read(_patched(content, table + 4, "<I", 4_000_000_000))


def test_eight_bit_values_in_sixteen_bit_colors(read: Read) -> None:
    content = bytearray(files.las(2, compressed=False))
    (first,) = struct.unpack_from("<I", content, 96)
    for i in range(400):
        content[first + i * 26 + 21 : first + i * 26 + 26 : 2] = bytes(3)  # the upper bytes
    np.testing.assert_array_equal(read(bytes(content)).colors, files.COLORS)
