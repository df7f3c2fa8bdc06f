"""E57: pages with checksums, scans with poses, streams of odd widths, and files that lie."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import cloud_files as files
import e57_files as e57
import numpy as np
import pytest
from e57_files import Scan, Stream, floats, whole
from hypothesis import given, settings
from hypothesis import strategies as st

from udflow.cloud.formats import read_cloud
from udflow.cloud.formats.e57_pages import crc32c
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

Read = Callable[[bytes], PointCloud]
REFERENCE = Path(__file__).with_name("libe57.e57")
POINTS = files.POINTS.astype(np.float64)
POSE = (
    '<pose type="Structure"><rotation type="Structure"><w type="Float">0.5</w><x type="Float">0.5'
    '</x><y type="Float">0.5</y><z type="Float">0.5</z></rotation><translation type="Structure">'
    '<x type="Float">512000</x><y type="Float">5403000</y><z type="Float"/></translation></pose>'
)


def xyz(count: int = 400) -> list[Stream]:
    return [floats(f"cartesian{axis}", POINTS[:count, i].tolist()) for i, axis in enumerate("XYZ")]


def test_every_width_and_several_packets(read: Read) -> None:
    cloud = read(e57.plain())
    assert cloud.format == "e57"
    assert cloud.warnings == ()
    np.testing.assert_allclose(cloud.points, POINTS, rtol=0, atol=6e-6)
    np.testing.assert_array_equal(cloud.points[:, 2], POINTS[:, 2])
    np.testing.assert_array_equal(cloud.colors, files.COLORS)


@pytest.mark.parametrize("bits", [1, 3, 8, 13, 16, 27, 32, 40, 63, 64])
def test_widths(bits: int, read: Read) -> None:
    low = -(2 ** (bits - 1))
    values = [low + (i * 0x9E3779B97F4A7C15) % 2**bits for i in range(400)]
    column = whole("cartesianX", values, low, low + 2**bits - 1, 0.5, 7.0)
    cloud = read(e57.e57(Scan([column, *xyz()[1:]], 400), packet=333))
    np.testing.assert_array_equal(cloud.points[:, 0], np.array(values, float) * 0.5 + 7.0)


def test_a_column_without_bits_is_constant(read: Read) -> None:
    flat = whole("cartesianX", [3] * 400, 3, 3, 2.0, 1.0)
    cloud = read(e57.e57(Scan([flat, *xyz()[1:]], 400)))
    assert set(cloud.points[:, 0]) == {7.0}


def test_scans_are_put_together_by_their_poses(read: Read) -> None:
    cloud = read(e57.e57(Scan(xyz(), 400, POSE), Scan(xyz(100), 100), Scan(xyz(1), 0)))
    turned = POINTS[:, [2, 0, 1]] + [512_000, 5_403_000, 0]  # by 120 degrees about (1, 1, 1)
    np.testing.assert_allclose(cloud.points, np.vstack([turned, POINTS[:100]]), rtol=0, atol=1e-8)


def test_spherical_coordinates_and_points_that_are_none(read: Read) -> None:
    x, y, z = POINTS.T
    distance = np.linalg.norm(POINTS, axis=1)
    streams = [
        floats("sphericalRange", distance.tolist()),
        floats("sphericalAzimuth", np.arctan2(y, x).tolist()),
        floats("sphericalElevation", np.arcsin(z / distance).tolist()),
        whole("sphericalInvalidState", [i % 4 == 0 for i in range(400)], 0, 2),
        Stream('<note type="String"/>', b"abc"),
    ]
    cloud = read(e57.e57(Scan(streams, 400)))
    assert cloud.dropped == 100
    np.testing.assert_allclose(cloud.points, np.delete(POINTS, np.s_[::4], axis=0), atol=1e-12)


def _colors(high: int) -> list[Stream]:
    values = (files.COLORS.astype(int) * high // 255).T.tolist()
    names = ("colorRed", "colorGreen", "colorBlue")
    return [whole(name, column, 0, 4095) for name, column in zip(names, values, strict=True)]


def test_colors_on_the_scale_that_the_scan_declares(read: Read) -> None:
    names = [f"color{name}Maximum" for name in ("Red", "Green", "Blue")]
    said = "".join(f'<{name} type="Integer">1020</{name}>' for name in names)
    limits = f'<colorLimits type="Structure">{said}</colorLimits>'
    declared = read(e57.e57(Scan([*xyz(), *_colors(1020)], 400, limits)))
    np.testing.assert_array_equal(declared.colors, files.COLORS)
    by_width = read(e57.e57(Scan([*xyz(), *_colors(4095)], 400)))
    np.testing.assert_allclose(by_width.colors, files.COLORS, atol=1)
    some = read(e57.e57(Scan([*xyz(), *_colors(4095)], 400), Scan(xyz(), 400)))
    assert some.colors is None
    assert some.warnings == ("the colours were ignored: not all scans have them",)


def test_a_file_of_the_reference_implementation(read: Read) -> None:
    cloud = read(REFERENCE.read_bytes())
    k = np.arange(300)
    own = np.stack([k * 37 % 101 - 50, k * 53 % 211 - 100, k * 71 % 307], axis=1) * 0.001
    turned = own[:, [2, 0, 1]] + [512_000, 5_403_000, 300]
    valid = k % 10 != 3
    colors = np.stack([k % 256, k * 3 % 256, k * 7 % 256], axis=1)[valid]
    np.testing.assert_allclose(cloud.points, np.vstack([turned[valid], own[valid]]), atol=1e-8)
    np.testing.assert_array_equal(cloud.colors, np.vstack([colors, colors]))
    assert cloud.dropped == 60


def test_the_checksum() -> None:
    known = [bytes(32), b"\xff" * 32, bytes(range(32))]
    rows = np.frombuffer(b"".join(known), np.uint8).reshape(3, 32)
    assert crc32c(rows).tolist() == [0x8A9136AA, 0x62A8AB43, 0x46DD794E]  # RFC 3720, B.4


def test_a_flipped_bit_is_noticed(read: Read) -> None:
    content = bytearray(e57.plain())
    content[700] ^= 4
    with pytest.raises(InvalidCloud, match="page 0 does not fit its checksum"):
        read(bytes(content))


@pytest.mark.parametrize(
    ("scan", "said"),
    [
        (Scan(xyz(), 400, claimed=401), "ends before"),
        (Scan(xyz(), 400, claimed=10**8), "bytes claim to hold|ends before"),
        (Scan(xyz(), 400, claimed=10**12), "claims 1000000000000 points"),
        (Scan(xyz(), 400, claimed=0), "holds no points"),
        (Scan(xyz(), 400, claimed=-1), "below zero"),
        (Scan(xyz(), 400, attributes={"fileOffset": 2**40}), "cannot be"),
        (Scan(xyz(), 400, attributes={"fileOffset": 1022}), "cannot be"),
        (Scan(xyz(), 400, attributes={"fileOffset": 96}), "not where|lie outside"),
        (Scan(xyz(), 400, attributes={"fileOffset": "x"}), "no whole number"),
        (Scan(xyz()[:2], 400), "neither Cartesian nor spherical"),
        (Scan([*xyz(), Stream('<a type="Integer" minimum="5" maximum="2"/>', b"")], 400), "limits"),
        (Scan([*xyz(), Stream('<a type="ScaledInteger" scale="x"/>', b"")], 400), "a number"),
        (Scan(xyz(), 400, codecs='<vectorChild type="Structure"/>'), "unknown way"),
        (Scan(xyz(), 400, POSE.replace("0.5", "9")), "rotation"),
        (Scan(xyz(), 400, POSE.replace("512000", "1e999")), "a number belongs"),
        (Scan(xyz(), 400, "<a>" * 70 + "</a>" * 70), "beyond reason"),
        (Scan(xyz(), 400, "<a>"), "XML section is damaged"),
    ],
)
def test_lies_are_refused_in_words(scan: Scan, said: str, read: Read) -> None:
    with pytest.raises(InvalidCloud, match=said):
        read(e57.e57(scan))


def test_points_without_bits_cannot_claim_gigabytes(read: Read) -> None:
    flat = [whole(f"cartesian{axis}", [1], 1, 1, 1.0) for axis in "XYZ"]
    with pytest.raises(InvalidCloud, match="packed bytes claim to hold"):
        read(e57.e57(Scan([*flat, *_colors(1)[:1]], 1, claimed=99_000_000)))


def test_scans_do_not_share_their_bytes(read: Read) -> None:
    first = Scan(xyz(), 400)
    again = Scan(xyz(1), 1, attributes={"fileOffset": 48})  # the place of the first
    with pytest.raises(InvalidCloud, match="not where the header says"):
        read(e57.e57(first, *[again] * 40))


def test_entities_are_never_expanded(read: Read) -> None:
    bomb = '<!DOCTYPE e [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>\n'
    with pytest.raises(InvalidCloud, match="document type, which is never read"):
        read(e57.e57(Scan(xyz(), 400), doctype=bomb))


@pytest.mark.parametrize(
    ("at", "format", "value", "said"),
    [
        (8, "<I", 2, "version 2"),
        (40, "<Q", 2048, "pages of 2048 bytes"),
        (16, "<Q", 2**40, "truncated"),
        (24, "<Q", 2**40, "cannot be"),
        (32, "<Q", 2**40, "claims 1099511627776 bytes"),
        (48, "<B", 7, "not where the header says"),
        (56, "<Q", 2**40, "not where the header says"),
        (64, "<Q", 2**40, "cannot be"),
        (64, "<Q", 48, "lie outside"),
        (80, "<B", 9, "contradicts itself"),
        (82, "<H", 2, "contradicts itself"),
        (100, "<H", 5, "wrong number of columns"),
        (102, "<H", 60_000, "shorter than its columns"),
    ],
)
def test_false_headers_are_refused_in_words(
    at: int, format: str, value: int, said: str, read: Read
) -> None:
    content = bytearray(e57.e57(Scan(xyz(), 400), pages=False))
    struct.pack_into(format, content, at, value)
    with pytest.raises(InvalidCloud, match=said):
        read(e57.sealed(bytes(content)))


def test_truncated_files(read: Read) -> None:
    content = e57.plain()
    for size in (20, 48, 1024, 2048, len(content) - 1024, len(content) - 1):
        with pytest.raises(InvalidCloud):
            read(content[:size])


_SMALL = e57.e57(Scan([*xyz(20), whole("colorRed", range(20), 0, 30)], 20, POSE), pages=False)


@settings(max_examples=150, deadline=None)
@given(
    changes=st.lists(
        st.tuples(st.integers(0, len(_SMALL) - 9), st.binary(min_size=1, max_size=8)),
        min_size=1,
        max_size=4,
    )
)
def test_damage_behind_true_checksums(
    changes: list[tuple[int, bytes]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = bytearray(_SMALL)
    for at, noise in changes:
        content[at : at + len(noise)] = noise
    path = tmp_path_factory.getbasetemp() / "damaged-e57"
    path.write_bytes(e57.sealed(bytes(content)))
    try:
        said, points = "", read_cloud(path).points
    except InvalidCloud as error:
        said, points = str(error), POINTS
    assert np.isfinite(points).all()
    assert not said or 20 < len(said) < 600
