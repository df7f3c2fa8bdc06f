"""NPY and NPZ: plain numbers only, sizes checked first."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud, UnknownFormat

Read = Callable[[bytes], PointCloud]


@pytest.mark.parametrize("code", ["<f4", ">f4", "<f8", ">f8", "<f2", "<i4", ">i2", "u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_number_types_and_orders(code: str, order: str, read: Read) -> None:
    points = np.asarray((files.POINTS + 5) * 20, dtype=code, order=order)
    np.testing.assert_array_equal(read(files.npy(points)).points, points)


def test_further_columns_are_told_by_their_values(read: Read) -> None:
    cloud = read(files.npy(np.hstack([files.POINTS, files.COLORS, files.NORMALS])))
    np.testing.assert_array_equal(cloud.colors, files.COLORS)
    np.testing.assert_array_equal(cloud.normals, files.NORMALS)


def test_members_of_an_archive(read: Read) -> None:
    world = files.POINTS.astype(np.float64) + files.UTM
    cloud = read(
        files.npz(
            compressed=True,
            normals=files.NORMALS,
            xyz=world,
            rgb=files.COLORS,
            labels=np.arange(3),
        )
    )
    np.testing.assert_array_equal(cloud.points, world)
    np.testing.assert_array_equal(cloud.colors, files.COLORS)
    np.testing.assert_array_equal(cloud.normals, files.NORMALS)
    np.testing.assert_array_equal(read(files.npz(whatever=world)).points, world)


class _Trap:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.path,))


def test_pickles_are_refused_and_not_run(read: Read, tmp_path: Path) -> None:
    trap = np.array([_Trap(tmp_path / "sprung")], dtype=object)
    for content in (files.npy(trap), files.npz(points=trap)):
        with pytest.raises(InvalidCloud, match="never read"):
            read(content)
    assert not (tmp_path / "sprung").exists()


def _with_shape(shape: str) -> bytes:
    return _with_header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}")


def _with_header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(1200)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (files.npy(np.zeros(5, [("x", "f4"), ("y", "f4")])), "named fields"),
        (files.npy(np.zeros((5, 3), complex)), "no plain numbers"),
        (files.npy(np.zeros((5, 2))), r"shape \(5, 2\)"),
        (files.npy(np.zeros(30)), r"shape \(30,\)"),
        (files.npy(np.zeros((3, 100))), "transpose"),
        (files.npy(np.zeros((0, 3))), "holds no points"),
        (files.npy(files.POINTS)[:-1], "truncated"),
        (_with_shape("(9999999999999, 3)"), "truncated"),
        (_with_shape("(-1, 3)"), "no usable shape"),
        (_with_header("{'descr': '<f8', 'fortran_order': False}"), "damaged"),
        (_with_header("(" * 5000), "damaged"),
        (_with_header("__import__('os').getcwd()"), "damaged"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(100), "at most 65536"),
        (files.npz(a=files.POINTS, b=files.POINTS), "no array called points"),
        (files.npz(points=files.POINTS, colors=files.COLORS[:7]), "400 points but 7 colours"),
        (files.npz(compressed=True, points=files.POINTS)[:-300], "damaged"),
    ],
)  # fmt: skip
def test_refused_in_words(content: bytes, said: str, read: Read) -> None:
    with pytest.raises(InvalidCloud, match=said):
        read(content)


def test_an_archive_that_expands_beyond_reason_is_refused(read: Read) -> None:
    bomb = files.npz(compressed=True, points=np.zeros((5_000_000, 3)))
    assert len(bomb) < 200_000
    with pytest.raises(InvalidCloud, match="claim to hold 120000128 bytes"):
        read(bomb)


def test_any_other_zip_is_named(read: Read) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("scan.ply", files.ply())
    with pytest.raises(UnknownFormat, match="zip archive, whatever its name says; unpack it"):
        read(file.getvalue())
