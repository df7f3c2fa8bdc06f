"""PCD: fields of any kind, the compression of PCL, and false headers."""

from __future__ import annotations

import struct
from collections.abc import Callable

import cloud_files as files
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from udflow.cloud.formats.lzf import lzf_decompress
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

Read = Callable[[bytes], PointCloud]
ROW = np.dtype(
    [
        ("pad", "u1", 3),
        ("z", "<f8"),
        ("y", "<f4"),
        ("histogram", "<i2", 4),
        ("x", "<f4"),
        ("rgba", "<u4"),
        ("nx", "<f4"),
        ("ny", "<f4"),
        ("nz", "<f4"),
    ]
)


def _rows() -> np.ndarray:
    rows = np.zeros(400, ROW)
    rows["x"], rows["y"], rows["z"] = files.POINTS.T
    rows["rgba"] = (255 << 24) + files.COLORS.astype(np.uint32) @ np.array([65536, 256, 1])
    rows["nx"], rows["ny"], rows["nz"] = files.NORMALS.T
    return rows


def _header(data: str, **changes: str) -> bytes:
    lines = {
        "VERSION": "0.7",
        "FIELDS": "_ z y histogram x rgba normal_x normal_y normal_z",
        "SIZE": "1 8 4 2 4 4 4 4 4",
        "TYPE": "U F F I F U F F F",
        "COUNT": "3 1 1 4 1 1 1 1 1",
        "WIDTH": "20",
        "HEIGHT": "20",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "400",
        "DATA": data,
        **changes,
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items() if value).encode()


def _check(cloud: PointCloud) -> None:
    np.testing.assert_array_equal(cloud.points, files.POINTS)
    np.testing.assert_array_equal(cloud.colors, files.COLORS)
    np.testing.assert_array_equal(cloud.normals, files.NORMALS)


def test_fields_of_any_size_count_and_order(read: Read) -> None:
    rows = _rows()
    _check(read(_header("binary") + rows.tobytes()))
    columns = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in ROW.names or ())
    packed = files.lzf_compress(columns)
    sizes = struct.pack("<II", len(packed), len(columns))
    _check(read(_header("binary_compressed") + sizes + packed))
    text = files.table(np.column_stack([rows[name] for name in ROW.names or ()]))
    _check(read(_header("ascii") + text))


def test_headers_of_old_versions(read: Read) -> None:
    old = b"# .PCD v.5\nVERSION .5\nCOLUMNS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 400\nDATA ascii\n"
    np.testing.assert_array_equal(read(old + files.table(files.POINTS)).points, files.POINTS)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"POINTS": "2147483648", "WIDTH": "", "HEIGHT": ""}, "claims 2147483648 points"),
        ({"POINTS": "50000000", "WIDTH": "", "HEIGHT": ""}, "truncated"),
        ({"POINTS": "-5"}, "below zero"),
        ({"POINTS": "399"}, "POINTS is 399 but WIDTH x HEIGHT is 400"),
        ({"POINTS": "", "WIDTH": ""}, "neither POINTS nor WIDTH"),
        ({"COUNT": "3 1 1 4 1 1 1 1 99999999"}, "more than 4096 numbers"),
        ({"COUNT": "3 1"}, "not of one length"),
        ({"SIZE": "1 8 4 2 4 4 4 4 3"}, "TYPE 'F' and SIZE 3"),
        ({"FIELDS": "_ z y histogram q rgba normal_x normal_y normal_z"}, "no x, y and z"),
        ({"DATA": "binary_squeezed"}, "unknown DATA 'binary_squeezed'"),
        ({"SPEED": "12"}, "no PCD keyword"),
    ],
)
def test_false_headers_are_refused_in_words(changes: dict[str, str], said: str, read: Read) -> None:
    content = _header("binary", **changes)
    if "SPEED" in changes:
        content = b"VERSION 0.7\n" + content.replace(b"VERSION", b"SPEED")
    with pytest.raises(InvalidCloud, match=said):
        read(content + _rows().tobytes())


def test_truncated_and_damaged_bodies(read: Read) -> None:
    for data in ("ascii", "binary", "binary_compressed"):
        with pytest.raises(InvalidCloud):
            read(files.pcd(data)[:-40])
    whole = files.pcd("binary_compressed")
    body = whole.index(b"DATA binary_compressed\n") + 23
    with pytest.raises(InvalidCloud, match="compressed block holds 6399 bytes"):
        read(whole[: body + 4] + struct.pack("<I", 6399) + whole[body + 8 :])
    with pytest.raises(InvalidCloud, match="compressed block is damaged"):
        read(whole[: body + 8] + b"\xff" * (len(whole) - body - 8))


def test_a_block_that_expands_beyond_reason_is_refused(read: Read) -> None:
    points = 50_000_000
    head = _header("binary_compressed", POINTS=str(points), WIDTH=str(points), HEIGHT="1")
    stride = ROW.itemsize
    with pytest.raises(InvalidCloud, match="which no scan does"):
        read(head + struct.pack("<II", 100, points * stride) + bytes(100))


@given(st.binary(max_size=600), st.integers(1, 30))
def test_lzf_gives_back_what_was_compressed(data: bytes, repeat: int) -> None:
    data *= repeat
    assert lzf_decompress(files.lzf_compress(data), len(data)) == data


def test_lzf_by_hand() -> None:
    # two literals; three bytes from two back (they repeat); 264 bytes from one back
    packed = b"\x01ab" + b"\x20\x01" + b"\xe0\xff\x00"
    assert lzf_decompress(packed, 269) == b"ababa" + b"a" * 264


@given(st.binary(max_size=200), st.integers(0, 5000))
def test_lzf_of_noise_ends(data: bytes, size: int) -> None:
    found = lzf_decompress(data, size)
    assert found is None or len(found) == size
