"""LAS, and LAZ through lazrs: airborne and mobile laser scans in scaled whole numbers."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw
from udflow.cloud.formats.laz import require_sound_chunks
from udflow.cloud.formats.source import Source
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

# Bytes of a point record by format, and where red, green and blue (uint16) begin.
_RECORD_BYTES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
_COLOR_OFFSET = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
_HEADER = struct.Struct("<4s20x2B68x H I I B H I 20x 6d")
_LONG_COUNT_AT = 247
_VLR = struct.Struct("<2x16sHH32x")
_CHUNK_POINTS = 250_000


@dataclass(frozen=True)
class LasHeader:
    """What is needed to find and scale the points."""

    first_byte: int
    format: int
    compressed: bool
    record_bytes: int
    points: int
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    header_bytes: int
    vlrs: int

    @property
    def dtype(self) -> np.dtype[np.void]:
        """xyz as scaled whole numbers, rgb where the format has colours."""
        names, formats, offsets = ["xyz"], ["(3,)<i4"], [0]
        if self.format in _COLOR_OFFSET:
            names.append("rgb")
            formats.append("(3,)<u2")
            offsets.append(_COLOR_OFFSET[self.format])
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.record_bytes}
        )


def read_las(source: Source, file: BinaryIO) -> PointCloud:
    """The points of a LAS or LAZ file in double precision, with their colours.

    Raises:
        InvalidCloud: a damaged header, an unknown point format, or a truncated file.
    """
    header = _read_header(source)
    source.require_count(header.points)
    chunks: Iterable[NDArray[Any]]
    if header.compressed:
        chunks = _decompressed(source, file, header)
    else:
        source.seek(header.first_byte)
        chunks = source.records(header.dtype, header.points, "the points")
    points = np.empty((header.points, 3))
    colors = (
        np.empty((header.points, 3), np.uint16) if "rgb" in (header.dtype.names or ()) else None
    )
    start = 0
    for chunk in chunks:
        part = slice(start, start + len(chunk))
        points[part] = chunk["xyz"] * header.scale + header.offset
        if colors is not None:
            colors[part] = chunk["rgb"]
        start += len(chunk)
    if colors is not None and not colors.any():
        colors = None
    return assemble(Raw(points, colors), format=source.format)


def _read_header(source: Source) -> LasHeader:
    fields = _HEADER.unpack(source.take(_HEADER.size, "the header"))
    _, major, minor, header_bytes, first_byte, vlrs, format_id, record_bytes, points, *rest = fields
    if (major, header_bytes >= 227) != (1, True) or not header_bytes <= first_byte <= source.size:
        raise source.fault("the header contradicts itself; the file is damaged or truncated")
    if minor >= 4:
        source.seek(_LONG_COUNT_AT)
        (long_count,) = struct.unpack("<Q", source.take(8, "the header"))
        points = long_count or points
    point_format = format_id & 0x3F
    if point_format not in _RECORD_BYTES or record_bytes < _RECORD_BYTES[point_format]:
        raise source.fault(
            f"unknown point format {point_format} with records of {record_bytes} bytes; "
            "save the file as LAS 1.2 to 1.4"
        )
    scale, offset = np.array(rest[:3]), np.array(rest[3:])
    if not (np.isfinite(scale).all() and np.isfinite(offset).all() and scale.all()):
        raise source.fault("the header's scale or offset is no usable number; the file is damaged")
    return LasHeader(
        first_byte, point_format, format_id >= 0x80, record_bytes, points, scale, offset,
        header_bytes, vlrs,
    )  # fmt: skip


def _decompressed(source: Source, file: BinaryIO, header: LasHeader) -> Iterator[NDArray[Any]]:
    """The points of a LAZ file in chunks."""
    source.seek(header.first_byte)
    source.require_expansion(header.points * header.record_bytes, source.remaining)
    record = _laszip_record(source, header)
    require_sound_chunks(source, record, header.first_byte, header.points, header.record_bytes)
    source.seek(header.first_byte)
    try:
        if lazrs.LazVlr(record).item_size() != header.record_bytes:
            raise source.fault("the compression record contradicts the header; the file is damaged")
        # The sequential decompressor: the parallel one also trusts the sizes in the chunk table.
        decompressor = lazrs.LasZipDecompressor(file, record)
        for start in range(0, header.points, _CHUNK_POINTS):
            count = min(_CHUNK_POINTS, header.points - start)
            data = bytearray(count * header.record_bytes)
            decompressor.decompress_many(data)
            yield np.frombuffer(data, header.dtype)
    except InvalidCloud:
        raise
    except Exception as error:  # lazrs names no common base of what it raises
        raise source.fault(
            "the compressed points are damaged or truncated; export or upload the file again"
        ) from error


def _laszip_record(source: Source, header: LasHeader) -> bytes:
    """The record that says how the points are compressed."""
    source.seek(header.header_bytes)
    for _ in range(header.vlrs):
        user, number, length = _VLR.unpack(source.take(_VLR.size, "the records"))
        data = source.take(length, "the records")
        if user.rstrip(b"\0") == b"laszip encoded" and number == 22204:
            return data
    raise source.fault("the points are compressed but no record says how; the file is damaged")
