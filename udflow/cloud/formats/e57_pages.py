"""The pages of an E57 file: 1020 bytes of content, then their checksum, which is always checked."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.source import Source

PAGE = 1024
CONTENT = PAGE - 4
_BATCH = 8192  # pages read at a time
_CASTAGNOLI = 0x82F63B78  # CRC-32C, bits reversed


class Pages:
    """The content of a file whose pages carry checksums, by logical positions.

    Raises:
        InvalidCloud: the file does not consist of whole pages.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        if source.size % PAGE:
            raise source.fault(
                f"{source.size} bytes are no whole pages of {PAGE}; the file is truncated. "
                "Export or upload it again"
            )
        self.size = source.size // PAGE * CONTENT

    def logical(self, physical: int, what: str) -> int:
        """A position in the file as a position in its content.

        Raises:
            InvalidCloud: it lies outside the file or inside a checksum.
        """
        page, within = divmod(physical, PAGE)
        if not (0 <= physical < self._source.size and within < CONTENT):
            raise self._source.fault(
                f"{what} is said to be at byte {physical}, where it cannot be; "
                "the file is damaged or truncated. Export or upload it again"
            )
        return page * CONTENT + within

    def read(self, start: int, count: int, what: str) -> bytes:
        """`count` bytes of content from a logical position on, all of them.

        Raises:
            InvalidCloud: they are not there, or a page does not fit its checksum.
        """
        if start + count > self.size:
            raise self._source.fault(
                f"{what} need {count} bytes but {max(0, self.size - start)} are left in the file; "
                "it is truncated or damaged. Export or upload it again"
            )
        first, last = start // CONTENT, -(-(start + count) // CONTENT)
        parts = [
            self._checked(page, min(_BATCH, last - page)) for page in range(first, last, _BATCH)
        ]
        content = b"".join(parts)
        return content[start - first * CONTENT :][:count]

    def _checked(self, first: int, count: int) -> bytes:
        self._source.seek(first * PAGE)
        data = self._source.take(count * PAGE, "the pages")
        pages = np.frombuffer(data, np.uint8).reshape(count, PAGE)
        said = np.ascontiguousarray(pages[:, CONTENT:]).view(">u4")[:, 0]
        content = np.ascontiguousarray(pages[:, :CONTENT])
        wrong = np.flatnonzero(crc32c(content) != said)
        if len(wrong):
            raise self._source.fault(
                f"page {first + int(wrong[0])} does not fit its checksum; the file is damaged. "
                "Export or upload it again"
            )
        return content.tobytes()


def crc32c(rows: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """CRC-32C of each row of (n, 2 k) bytes, two bytes of all rows at a time."""
    table = _table()
    words = np.ascontiguousarray(rows.view("<u2").T)
    state = np.full(len(rows), 0xFFFFFFFF, np.uint32)
    for word in words:
        state = table[(state ^ word) & 0xFFFF] ^ (state >> 16)
    return ~state


@cache
def _table() -> NDArray[np.uint32]:
    """What each pair of bytes does to the state."""
    state: NDArray[np.uint32] = np.arange(1 << 16, dtype=np.uint32)
    for _ in range(16):
        state = (state >> np.uint32(1)) ^ (state & np.uint32(1)) * np.uint32(_CASTAGNOLI)
    return state
