"""The points of one scan in an E57 file: packets that carry a stream of bits for each column."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.e57_pages import Pages
from udflow.cloud.formats.e57_xml import Column, ScanPart
from udflow.cloud.formats.source import Source

_SECTION = struct.Struct("<B7xQQQ")  # kind, bytes, place of the packets, place of the index
_PACKET = struct.Struct("<BBH")  # kind, flags, bytes - 1
_COMPRESSED_VECTOR = 1
_INDEX, _DATA, _EMPTY = 0, 1, 2
_WINDOW = 8 * 1024 * 1024  # bytes read at a time
_LARGEST_PACKET = 1 << 16
_BATCH = 1 << 16  # values unpacked at a time, a multiple of 8


def read_streams(
    source: Source, pages: Pages, part: ScanPart, wanted: Sequence[int], limit: int
) -> tuple[dict[int, bytes], int]:
    """The wanted streams of a scan by their numbers, and the bytes of its section.

    Raises:
        InvalidCloud: the section is longer than `limit`, or its packets contradict themselves.
    """
    what = "the points of a scan"
    start = pages.logical(part.physical, what)
    kind, length, data, _ = _SECTION.unpack(pages.read(start, _SECTION.size, what))
    if kind != _COMPRESSED_VECTOR or not _SECTION.size <= length <= limit:
        raise source.fault(f"{what} are not where the header says; the file is damaged")
    first, end = pages.logical(data, what), start + length
    if not start + _SECTION.size <= first <= end:
        raise source.fault(f"{what} lie outside of their section; the file is damaged")
    streams: dict[int, list[bytes]] = {number: [] for number in wanted}
    for packet in _packets(source, pages, first, end):
        _unpack_streams(source, packet, streams, len(part.columns))
    return {number: b"".join(pieces) for number, pieces in streams.items()}, length


def _packets(source: Source, pages: Pages, position: int, end: int) -> Iterator[bytes]:
    """The data packets of a section."""
    window, at = b"", 0
    while position < end:
        if len(window) - at < min(_LARGEST_PACKET, end - position):
            window, at = pages.read(position, min(_WINDOW, end - position), "the packets"), 0
        if len(window) - at < _PACKET.size:
            raise source.fault("a section ends inside a packet; the file is damaged")
        kind, _, less = _PACKET.unpack_from(window, at)
        size = less + 1
        if kind not in (_INDEX, _DATA, _EMPTY) or size < 4 or position + size > end:
            raise source.fault("a packet of points contradicts itself; the file is damaged")
        if kind == _DATA:
            yield window[at : at + size]
        at, position = at + size, position + size


def _unpack_streams(
    source: Source, packet: bytes, streams: dict[int, list[bytes]], count: int
) -> None:
    """Adds what a data packet holds of each stream that is wanted."""
    at = 6 + 2 * count
    if len(packet) < at or int.from_bytes(packet[4:6], "little") != count:
        raise source.fault("a packet of points has a wrong number of columns; it is damaged")
    lengths = struct.unpack_from(f"<{count}H", packet, 6)
    if at + sum(lengths) > len(packet):
        raise source.fault("a packet of points is shorter than its columns; it is damaged")
    for number, length in enumerate(lengths):
        if number in streams:
            streams[number].append(packet[at : at + length])
        at += length


def values_of(source: Source, column: Column, stream: bytes, count: int) -> NDArray[Any]:
    """The first `count` values of a column's stream, (count,).

    Raises:
        InvalidCloud: the stream is too short.
    """
    if column.kind == "other":
        raise source.fault(f"{column.name} is no number; the file is damaged")
    if 8 * len(stream) < count * column.bits:
        raise source.fault(
            f"the header claims {count} points but {column.name} ends before; the file is "
            "truncated or damaged. Export or upload it again"
        )
    if column.kind != "integer":
        return np.frombuffer(stream, f"<f{column.bits // 8}", count)
    stored = _unpacked(stream, column.bits, count) + np.int64(column.minimum)
    return stored * column.scale + column.offset


def _unpacked(stream: bytes, bits: int, count: int) -> NDArray[np.int64]:
    """`count` whole numbers of so many bits each, lowest bit first; above 63 bits they wrap."""
    if bits == 0:
        return np.zeros(count, np.int64)
    size = next(size for size in (8, 16, 32, 64) if bits <= size)
    data = np.frombuffer(stream, np.uint8)
    values = np.empty(count, np.int64)
    for start in range(0, count, _BATCH):
        number = min(_BATCH, count - start)
        first = start * bits // 8
        packed = data[first : first + -(-number * bits // 8)]
        if bits != size:
            rows = np.unpackbits(packed, count=number * bits, bitorder="little")
            padded = np.zeros((number, size), np.uint8)
            padded[:, :bits] = rows.reshape(number, bits)
            packed = np.packbits(padded, axis=None, bitorder="little")
        values[start : start + number] = packed.view(f"<u{size // 8}").astype(np.int64)
    return values
