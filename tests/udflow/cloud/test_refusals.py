"""What is no scan is refused in words; what is damaged never harms the process."""

from __future__ import annotations

import os
import resource
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cloud_files as files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from udflow.cloud.formats import read_cloud
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud, UnknownFormat

Read = Callable[[bytes], PointCloud]
SAMPLES = files.samples()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x1f\x8b\x08\0\0", "compressed with gzip; unpack it"),
        (b"BZh91AY", "compressed with bzip2"),
        (b"\x28\xb5\x2f\xfd\0", "compressed with Zstandard"),
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
        (b"\xff\xd8\xff\xe0", "a JPEG image"),
        (b"%PDF-1.7", "a PDF document"),
        (b"\x80\x04\x95", "a Python pickle, which is never read"),
        ("x y z\n1 2 3\n".encode("utf-16"), "UTF-16 text"),
        (b"<!doctype html><title>404</title>", "an HTML or XML page"),
        (b'{"asset": {"version": "2.0"}}', "a JSON or glTF text file; export .glb"),
        (bytes(range(256)) * 9, "binary data of no known kind"),
        (b"\0", "binary data of no known kind"),
        (b" \n\n ", "text, but no table of points"),
    ],
)
def test_foreign_files_are_named(content: bytes, said: str, read: Read) -> None:
    with pytest.raises(UnknownFormat, match=said):
        read(content)


def test_empty_and_missing_and_special_files(tmp_path: Path, read: Read) -> None:
    with pytest.raises(InvalidCloud, match="the file is empty"):
        read(b"")
    with pytest.raises(FileNotFoundError):
        read_cloud(tmp_path / "missing")
    with pytest.raises(InvalidCloud, match="no regular file"):
        read_cloud(tmp_path)
    os.mkfifo(tmp_path / "pipe")  # opening it would wait for a writer for ever
    with pytest.raises(InvalidCloud, match="no regular file"):
        read_cloud(tmp_path / "pipe")


def _read_or_words(path: Path) -> PointCloud | str:
    try:
        return read_cloud(path)
    except InvalidCloud as error:
        return str(error)


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("kept", [0.02, 0.3, 0.9])
def test_truncated_files_are_refused_unless_they_state_no_count(
    name: str, kept: float, tmp_path: Path
) -> None:
    content = SAMPLES[name]
    path = tmp_path / "scan"
    path.write_bytes(content[: int(kept * len(content))])
    found = _read_or_words(path)
    if isinstance(found, str):
        assert len(found) > 20
    else:
        assert name in ("text-csv", "obj", "stl-ascii")
        assert len(found.points) < 400


_SPLICES = [b"9" * 30, b"-", b"\n", b" ", b"nan", b"1e999", b"{", b"[", b"element x 99999999\n"]
_SPLICES += [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"list uchar int ", b""]


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A well-formed file with a few bytes replaced, mostly in its first 400."""
    content = bytearray(SAMPLES[draw(st.sampled_from(sorted(SAMPLES)))])
    for _ in range(draw(st.integers(1, 5))):
        reach = draw(st.sampled_from([100, 400, len(content)]))
        at = draw(st.integers(0, min(reach, len(content))))
        length = draw(st.sampled_from([0, 1, 1, 2, 4, 8, 40]))
        splice = draw(st.sampled_from(_SPLICES) | st.binary(min_size=1, max_size=8))
        content[at : at + length] = splice
    return bytes(content[: draw(st.sampled_from([len(content)] * 4 + [len(content) // 2]))])


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "scan"


def _check_sound(found: PointCloud | str) -> None:
    if isinstance(found, str):
        assert 20 < len(found) < 600
        return
    assert found.points.dtype == np.float64
    assert found.points.shape == (len(found.points), 3)
    assert len(found.points) > 0
    assert np.isfinite(found.points).all()
    for extra, kind in ((found.colors, np.uint8), (found.normals, np.float32)):
        assert extra is None or (extra.shape == found.points.shape and extra.dtype == kind)


@settings(max_examples=400, deadline=None)
@given(content=damaged())
def test_damage_gives_a_sound_cloud_or_words(content: bytes, scratch: Path) -> None:
    scratch.write_bytes(content)
    _check_sound(_read_or_words(scratch))


SIGNATURES = [b"", b"ply\n", b"LASF", b"glTF", b"\x93NUMPY", b"PK\3\4", b"OFF\n", b"v 1 2 3\n"]
SIGNATURES += [b"ASTM-E57"]


@settings(max_examples=100, deadline=None)
@given(signature=st.sampled_from(SIGNATURES), noise=st.binary(max_size=400))
def test_noise_behind_every_signature(signature: bytes, noise: bytes, scratch: Path) -> None:
    scratch.write_bytes(signature + noise)
    _check_sound(_read_or_words(scratch))


_MEASURED = """
import resource, sys
from pathlib import Path
from udflow.cloud.formats import read_cloud
from udflow.errors import InvalidCloud
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    found = len(read_cloud(Path(sys.argv[1])).points)
except InvalidCloud:
    found = 0
print(found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def _growth(path: Path, points: int) -> int:
    """Bytes by which the peak memory of a fresh process grows while it reads a file.

    The file must give that many points; none means that it must be refused.
    """
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (20, 20)),
    )
    found, growth = map(int, done.stdout.split())
    assert found == points
    return growth * 1024


COUNT = 300_000
PLAIN = np.random.default_rng(0).normal(size=(COUNT, 3)).astype(np.float32)


def _text() -> bytes:
    return files.table(np.round(PLAIN[:3000], 4)) * (COUNT // 3000)


def _ply(format: str, body: bytes) -> bytes:
    return files.ply_header(format, *files.vertex_lines(COUNT)) + body


def _organised() -> bytes:
    """A compressed PCD of which nearly all points are undefined, as small as it can be."""
    head = (
        b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2000\nHEIGHT 1000\nDATA binary_compressed\n"
    )
    undefined = np.full(66, np.nan, "<f4").tobytes()  # 264 bytes
    # Then copies of 264 bytes from four bytes back, until the axis has two million values.
    axis = files.lzf_compress(PLAIN[:66, 0].tobytes() + undefined) + b"\xe0\xff\x03" * 30_301
    axis += files.lzf_compress(undefined[:8])
    size = 3 * 4 * 2_000_000
    return head + struct.pack("<II", 3 * len(axis), size) + 3 * axis


LARGE: dict[str, Callable[[], bytes]] = {
    "ply": lambda: _ply("binary_little_endian", PLAIN.tobytes()),
    "ply-ascii": lambda: _ply("ascii", _text()),
    "text": _text,
    "obj": lambda: b"v " + _text().strip().replace(b"\n", b"\nv "),
    "npy": lambda: files.npy(PLAIN),
    "npz": lambda: files.npz(compressed=True, points=PLAIN),
    "laz": lambda: files.las(7, compressed=True, points=PLAIN),
    "pcd-organised": _organised,
}


@pytest.mark.parametrize("name", LARGE)
def test_memory_stays_within_64_mib_and_four_times_the_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / "scan"
    path.write_bytes(LARGE[name]())
    points = 66 if name == "pcd-organised" else COUNT
    assert _growth(path, points) < 64 * 2**20 + 4 * path.stat().st_size


BOMBS: dict[str, Callable[[], bytes]] = {
    "ply": lambda: files.ply_header("binary_little_endian", *files.vertex_lines(99_999_999)),
    "ply-lists": lambda: _ply("binary_little_endian", PLAIN.tobytes()).replace(
        b"element vertex", b"element face 100000000\nproperty list uchar int i\nelement vertex"
    ),
    "npy": lambda: files.npy(PLAIN[:1]).replace(b"(1, 3), }       ", b"(99999999, 3), }"),
    "npz": lambda: files.npz(compressed=True, points=np.zeros((9_000_000, 3))),
    "laz": lambda: _patched_count(files.las(7, compressed=True)),
    "pcd": lambda: _organised().replace(b"WIDTH 2000", b"WIDTH 99999"),
}


def _patched_count(content: bytes) -> bytes:
    """LAZ 1.4 that claims ninety million points."""
    return content[:247] + struct.pack("<Q", 90_000_000) + content[255:]


@pytest.mark.parametrize("name", BOMBS)
def test_files_that_claim_more_than_they_hold_cost_nothing(name: str, tmp_path: Path) -> None:
    path = tmp_path / "scan"
    path.write_bytes(BOMBS[name]())
    assert _growth(path, points=0) < 32 * 2**20 + path.stat().st_size


def test_reading_imports_no_torch() -> None:
    code = (
        "import sys, udflow.cloud.formats, udflow.cloud.inspection; print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
