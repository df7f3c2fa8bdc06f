"""One open file whose size is known: nothing is read or allocated that is not there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from udflow.errors import InvalidCloud

HEADER_LIMIT = 64 * 1024
HEADER_LINE_LIMIT = 4 * 1024
MAX_POINTS = 100_000_000
# Packed formats may grow on reading, within reason: a file of a few kilobytes that claims
# gigabytes is an attack. Organised clouds of undefined points reach 30 : 1.
EXPANSION_ALLOWANCE = 64 * 1024 * 1024
MAX_EXPANSION = 32
_CHUNK_BYTES = 8 * 1024 * 1024
_TEXT_BLOCK = 1024 * 1024


class Source:
    """A readable binary file of known size.

    Attributes:
        format: name of the format being read, for messages ("ply", "pcd", ...).
        size: bytes in the file.
        position: bytes consumed so far.
    """

    def __init__(self, file: BinaryIO, size: int, format: str) -> None:
        self._file = file
        self.format = format
        self.size = size
        self.position = 0

    @property
    def remaining(self) -> int:
        """Bytes not consumed yet."""
        return self.size - self.position

    def fault(self, message: str) -> InvalidCloud:
        """The error to raise for this file, with the format's name in front."""
        return InvalidCloud(f"{self.format.upper()}: {message}")

    def require(self, count: int, what: str) -> None:
        """Refuse unless `count` more bytes are there.

        Raises:
            InvalidCloud: the file is shorter than its header says.
        """
        if count > self.remaining:
            raise self.fault(
                f"{what} need {count} bytes but {self.remaining} are left in the file; "
                "it is truncated or its header is wrong. Export or upload it again"
            )

    def take(self, count: int, what: str) -> bytes:
        """The next `count` bytes, all of them."""
        self.require(count, what)
        data = self._file.read(count)
        if len(data) != count:
            raise self.fault("the file became shorter while it was read; upload it again")
        self.position += count
        return data

    def seek(self, position: int) -> None:
        """Continue reading at a byte position inside the file."""
        if not 0 <= position <= self.size:
            raise self.fault(f"refers to byte {position} of a file of {self.size} bytes")
        self._file.seek(position)
        self.position = position

    def whole(self, text: str, what: str) -> int:
        """A whole number of a header, at least 0.

        Raises:
            InvalidCloud: it is no whole number, negative, or longer than any real count.
        """
        if not (text.isascii() and text.removeprefix("-").isdecimal() and len(text) <= 19):
            raise self.fault(f"{what[:80]} is no whole number; the file is damaged")
        if text.startswith("-"):
            raise self.fault(f"{what[:80]} is {text}, below zero; the file is damaged")
        return int(text)

    def header_line(self) -> str:
        """The next line of a text header, without its line end.

        Raises:
            InvalidCloud: no line end within the limits for headers, or the file ends.
        """
        allowed = min(HEADER_LINE_LIMIT, HEADER_LIMIT - self.position)
        line = self._file.readline(allowed) if allowed > 0 else b""
        if not line.endswith(b"\n"):
            if self.remaining == len(line):
                raise self.fault("the file ends inside its header; export or upload it again")
            raise self.fault(
                f"the header has a line over {HEADER_LINE_LIMIT} bytes or is longer than "
                f"{HEADER_LIMIT} bytes; the file is damaged or not what it claims to be"
            )
        self.position += len(line)
        return line.decode("latin-1").rstrip("\r\n")

    def records(self, dtype: np.dtype[Any], count: int, what: str) -> Iterator[NDArray[Any]]:
        """`count` fixed-size records as arrays of a few megabytes each."""
        self.require(count * dtype.itemsize, what)
        step = max(1, _CHUNK_BYTES // dtype.itemsize)
        for start in range(0, count, step):
            length = min(step, count - start)
            yield np.frombuffer(self.take(length * dtype.itemsize, what), dtype=dtype)

    def text_blocks(self, line_limit: int = HEADER_LINE_LIMIT) -> Iterator[list[str]]:
        """The rest of the file as lists of lines, about a megabyte at a time.

        Raises:
            InvalidCloud: a line is longer than `line_limit` bytes.
        """
        rest = b""
        while self.remaining > 0:
            block = rest + self.take(min(_TEXT_BLOCK, self.remaining), "text")
            cut = len(block) if self.remaining == 0 else _last_line_end(block)
            lines = block[:cut].decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
            rest = block[cut:]
            split = lines.split("\n")
            if max(map(len, split)) > line_limit or len(rest) > line_limit:
                raise self.fault(
                    f"a line is longer than {line_limit} characters; this is no text table "
                    "of points"
                )
            yield split

    def require_expansion(self, expanded: int, packed: int) -> None:
        """Refuse packed data that would grow beyond reason.

        Raises:
            InvalidCloud: `packed` bytes claim to hold `expanded` bytes.
        """
        if expanded > EXPANSION_ALLOWANCE + MAX_EXPANSION * packed:
            raise self.fault(
                f"{packed} packed bytes claim to hold {expanded} bytes, which no scan does; "
                "save the file without compression"
            )

    def require_count(self, count: int) -> None:
        """Refuse a number of points that is negative, zero or beyond what fits a machine."""
        if count < 0:
            raise self.fault(f"the header claims {count} points; the file is damaged")
        if count == 0:
            raise self.fault("the file holds no points; choose one that does")
        if count > MAX_POINTS:
            raise self.fault(
                f"the header claims {count} points; at most {MAX_POINTS} are read. "
                "Thin the scan out first if it really is that large"
            )


def _last_line_end(block: bytes) -> int:
    """Where to cut a block so that no line is torn. \\r counts too: old Mac files have no \\n."""
    newline = block.rfind(b"\n") + 1
    return newline or block.rfind(b"\r", 0, len(block) - 1) + 1
