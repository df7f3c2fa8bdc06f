"""Fuzzes readers in this process, which may crash, hang or eat memory.

With `tests` on PYTHONPATH:

    python tests/fuzz/harness.py fuzz SECONDS FOLDER FORMAT...
    python tests/fuzz/harness.py replay 0 FOLDER FILE...

The file that is being read lies in FOLDER/FORMAT; if this process dies it is the crasher, to be
kept in tests/fuzz/corpus. Prints {"examples": n, "sound": n, "growth": bytes, "slowest": seconds}.
"""

from __future__ import annotations

import json
import resource
import signal
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cloud_files
import numpy as np
from e57_files import plain, sealed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from udflow.cloud.formats import read_cloud
from udflow.errors import InvalidCloud

LONGEST_S = 10
ALLOWED = 64 << 20
PER_BYTE = 4
ROUND = 100  # examples between two new beginnings; the last round is finished unread
WORDS = [b"9" * 30, b"-1", b"-", b"\n", b" ", b"nan", b"1e999", b"1e-320", b"{", b"[", b"", b"\0"]
WORDS += [b"element vertex 99999999\n", b"property list uchar int i\n", b"POINTS 4294967295\n"]
WORDS += [b"WIDTH 99999999\n", b"COUNT 99999999\n", b"binary_compressed", b"big_endian", b"double"]
WORDS += [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"\xff" * 8]
WORDS += [b"(99999999999, 3)", b"|O", b"<f8", b"'fortran_order': True", b"\x80\x04", b"JSON"]
WORDS += [b'"byteLength": 99999999', b'"count": 4294967295', b"recordCount='9999999999'"]


@dataclass
class Figures:
    """examples: read; sound: of them clouds; growth: most memory one took beyond its due;
    slowest: seconds."""

    examples: int = 0
    sound: int = 0
    growth: int = 0
    slowest: float = 0.0

    def read(self, path: Path, content: bytes) -> None:
        """One file. Whatever is raised but InvalidCloud ends this process."""
        path.write_bytes(content)
        signal.alarm(LONGEST_S)
        Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
        before, began = _status("VmRSS"), time.perf_counter()
        said = self._said(path)
        assert said is None or 20 < len(said) < 1000, said
        self.sound += said is None
        self.slowest = max(self.slowest, time.perf_counter() - began)
        signal.alarm(0)
        growth = _status("VmHWM") - before
        assert growth < ALLOWED + PER_BYTE * len(content), f"took {growth >> 20} MB"
        self.growth = max(self.growth, growth)
        self.examples += 1

    def _said(self, path: Path) -> str | None:
        try:
            cloud = read_cloud(path)
        except InvalidCloud as error:
            return str(error)
        assert len(cloud.points) > 0
        assert np.isfinite(cloud.points).all()
        return None


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(f"{name}:")]
    return int(line.split()[1]) * 1024


def seeds() -> dict[str, bytes]:
    """A well-formed small file of every format."""
    return cloud_files.samples() | {"e57": plain()}


@st.composite
def damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """A file with a few pieces replaced, moved, doubled or cut off, mostly in its header."""
    content = bytearray(whole)
    for _ in range(draw(st.integers(1, 6))):
        reach = draw(st.sampled_from([60, 300, 1500, len(content)]))
        at = draw(st.integers(0, min(reach, len(content))))
        length = draw(st.sampled_from([0, 1, 1, 2, 4, 8, 40, 400]))
        kind = draw(st.sampled_from(["word", "word", "bytes", "bit", "again", "cut"]))
        if kind == "word":
            content[at : at + length] = draw(st.sampled_from(WORDS))
        elif kind == "bytes":
            content[at : at + length] = draw(st.binary(min_size=1, max_size=8))
        elif kind == "again":
            content[at:at] = content[at : at + length] * draw(st.integers(1, 3))
        elif kind == "bit" and at < len(content):
            content[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "cut" and draw(st.booleans()):
            del content[max(at, 1) :]
    # pages of E57 carry checksums: mostly right ones, or damage would be met by nothing else
    sums = whole.startswith(b"ASTM-E57") and draw(st.sampled_from([True, True, True, False]))
    return sealed(bytes(content)) if sums else bytes(content)


def fuzz(name: str, seconds: float, folder: Path, figures: Figures) -> None:
    """Damaged files of one format until the time is over."""
    deadline, path = time.monotonic() + seconds, folder / name
    whole = seeds()[name]

    def one(content: bytes) -> None:
        if time.monotonic() < deadline:
            figures.read(path, content)

    run: Any = settings(
        max_examples=ROUND if seconds > 10 else 12,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )(given(content=damaged(whole))(one))
    figures.read(path, whole)
    while time.monotonic() < deadline:
        run()
    path.unlink()


def main() -> None:
    """See above."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    mode, seconds, folder, *names = sys.argv[1:]
    figures = Figures()
    for name in names:
        if mode == "replay":
            figures.read(Path(folder, "replayed"), Path(name).read_bytes())
        else:
            fuzz(name, float(seconds), Path(folder), figures)
    sys.stdout.write(json.dumps(asdict(figures)))


if __name__ == "__main__":
    main()
