"""Tables in text: separators, headers and columns are found by looking."""

from __future__ import annotations

import time
from collections.abc import Callable

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud, UnknownFormat

Read = Callable[[bytes], PointCloud]
EXPECTED = [[1.5, -2.25, 3.0], [4.0, 5.5, -6.75]]


@pytest.mark.parametrize(
    "text",
    [
        "1.5 -2.25 3\n4 5.5 -6.75\n",
        "  1.5   -2.25\t3 \r\n\r\n4 5.5 -6.75",
        "1.5\t-2.25\t3\n4\t5.5\t-6.75\n",
        "1.5,-2.25,3\n4,5.5,-6.75\n",
        "1.5 , -2.25 , 3\n4 , 5.5 , -6.75\n",
        "1.5,-2.25,3,\n4,5.5,-6.75,\n",
        "1.5;-2.25;3\n4;5.5;-6.75\n",
        "1,5;-2,25;3,0\n4,0;5,5;-6,75\n",
        "1,5 -2,25 3,0\n4,0 5,5 -6,75\n",
        "1.5 -2.25 3\r4 5.5 -6.75\r",
        "# a comment\n1.5 -2.25 3 # the first\n# another\n4 5.5 -6.75\n",
        "// X Y Z\n1.5 -2.25 3\n4 5.5 -6.75\n",
        "\ufeffx,y,z\n1.5,-2.25,3\n4,5.5,-6.75\n",
        "2\n1.5 -2.25 3 0.7\n4 5.5 -6.75 0.7\n",
        "+1.5 -.225e1 3.\n4E0 5.5 -6.75\n",
        '"label","Y [m]","X [m]","Z [m]"\nchair,-2.25,1.5,3\ntable,5.5,4,-6.75\n',
    ],
)
def test_dialects(text: str, read: Read) -> None:
    cloud = read(text.encode())
    assert cloud.format == "text"
    assert cloud.points.tolist() == EXPECTED
    assert cloud.warnings == ()


def _rows(*columns: np.ndarray) -> bytes:
    return files.table(np.hstack([files.POINTS, *columns]))


def test_columns_without_names_are_told_by_their_values(read: Read) -> None:
    intensity = np.linspace(0.1, 0.9, 400)[:, None]
    for order in ((files.NORMALS, files.COLORS), (files.COLORS, files.NORMALS)):
        cloud = read(_rows(intensity, *order))
        np.testing.assert_array_equal(cloud.points, files.POINTS)
        np.testing.assert_array_equal(cloud.colors, files.COLORS)
        np.testing.assert_array_equal(cloud.normals, files.NORMALS)
    plain = read(_rows(intensity, intensity, intensity))
    assert plain.colors is None
    assert plain.normals is None


def test_named_columns_in_any_order(read: Read) -> None:
    header = b"//R G B Nx Ny Nz X Y Z\n"
    body = files.table(np.hstack([files.COLORS, files.NORMALS, files.POINTS]))
    cloud = read(header + body)
    np.testing.assert_array_equal(cloud.points, files.POINTS)
    np.testing.assert_array_equal(cloud.colors, files.COLORS)
    np.testing.assert_array_equal(cloud.normals, files.NORMALS)


def test_a_header_without_x_y_z_is_a_warning(read: Read) -> None:
    cloud = read(b"east,north,up\n1,2,3\n4,5,6\n")
    assert cloud.points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert "first three columns" in cloud.warnings[0]


def test_the_count_line_of_pts(read: Read) -> None:
    with pytest.raises(InvalidCloud, match="claims 3 points but 2 follow"):
        read(b"3\n1 2 3\n4 5 6\n")
    assert "claims 1 points but 2" in read(b"1\n1 2 3\n4 5 6\n").warnings[0]
    with pytest.raises(InvalidCloud, match="claims 9999999999 points"):
        read(b"9999999999\n1 2 3\n")


def test_nan_and_infinity_in_text(read: Read) -> None:
    cloud = read(b"1 2 3\nnan nan nan\n-inf 0 0\n4 5 1e400\n7 8 9\n")
    assert cloud.points.tolist() == [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]]
    assert cloud.dropped == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3\n4 5\n", "line 2 has 2 columns where at least 3 are needed: '4 5'"),
        ("1 2 3\n# fine\n4 five 6\n", "line 3 holds 'five' where a number belongs"),
        ("1,2,3\n4,,6\n", "line 2 holds '' where a number belongs"),
        ("x,y,z\n1,2,3\n0x1p3,1,2\n", "line 3 holds '0x1p3'"),
        ("1 2 3\n1_0 2 3\n", "line 2 holds '1_0'"),
        ("1 2 3\n" + "4 5 6 " * 2000, "a line is longer than 4096 characters"),
        ("nan nan nan\n" * 5, "none of the 5 points has finite coordinates"),
    ],
)
def test_lines_that_do_not_fit_are_named(text: str, said: str, read: Read) -> None:
    with pytest.raises(InvalidCloud) as caught:
        read(text.encode())
    assert said in str(caught.value)


@pytest.mark.parametrize("text", ["hello\nworld\n", "1 2\n3 4\n", "a\nb\nc\nd\n1 2 3\n"])
def test_text_that_is_no_table(text: str, read: Read) -> None:
    with pytest.raises(UnknownFormat, match="text, but no table of points"):
        read(text.encode())


def test_a_million_lines_take_seconds(read: Read) -> None:
    block = files.table(np.round(files.POINTS, 4))
    content = block * 2500
    started = time.process_time()
    cloud = read(content)
    assert len(cloud.points) == 1_000_000
    np.testing.assert_array_equal(cloud.points[-400:], cloud.points[:400])
    assert time.process_time() - started < 10.0
