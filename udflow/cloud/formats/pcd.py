"""PCD of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw, Triple, Wanted, first_triple, from_records, from_table
from udflow.cloud.formats.lzf import lzf_decompress
from udflow.cloud.formats.pcd_header import PcdHeader, read_pcd_header
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import Source
from udflow.cloud.formats.text_lines import numbered_blocks
from udflow.cloud.point_cloud import PointCloud

_PACKED = ("packed_r", "packed_g", "packed_b")


def read_pcd(source: Source) -> PointCloud:
    """The points of a PCD file; undefined points of organised clouds are dropped.

    The viewpoint is where the sensor stood; as in PCL the points are not moved by it.

    Raises:
        InvalidCloud: a damaged header, or a file shorter than its header says.
    """
    header = read_pcd_header(source)
    source.require_count(header.points)
    names = [column.name for column in header.columns]
    points = first_triple(names, [("x", "y", "z")])
    if points is None:
        raise source.fault("the fields name no x, y and z; the file is no cloud of points")
    colors = first_triple(names, [_PACKED, ("r", "g", "b"), ("red", "green", "blue")])
    normals = first_triple(names, [("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz")])
    wanted = Wanted(points, colors, normals)
    if header.data == "ascii":
        return assemble(_read_ascii(source, header, wanted), format=source.format)
    read = _read_binary if header.data == "binary" else _read_compressed
    raw = read(source, header, wanted)
    warnings: tuple[str, ...] = ()
    # PCL pads its files to whole memory pages.
    if source.remaining > 4096:
        warnings = (f"{source.remaining} bytes after the end of the data were ignored",)
    return assemble(raw, format=source.format, warnings=warnings)


def _read_ascii(source: Source, header: PcdHeader, wanted: Wanted) -> Raw:
    columns = header.columns
    source.require(header.points * 2 * sum(c.text >= 0 for c in columns) - 1, "the rows")
    packed = wanted.colors is not None and columns[wanted.colors[0]].text < 0
    if packed:
        at = next(i for i, c in enumerate(columns) if c.name in ("rgb", "rgba"))
        wanted = Wanted(wanted.points, (at, at, at), wanted.normals)
    table = read_rows(
        source,
        numbered_blocks(source, header.lines + 1),
        [columns[i].text for i in wanted.flat],
        expected=header.points,
    )
    whole = wanted.colors is not None and columns[wanted.colors[0]].code[0] in "iu"
    raw = from_table(table, wanted, whole_colors=whole)
    if not packed:
        return raw
    return Raw(raw.points, _unpacked(table[:, 3], whole), raw.normals)


def _unpacked(values: NDArray[np.float64], whole: bool) -> NDArray[np.uint8]:
    """Packed colours (n,) as written in text, whole numbers or the same bits as a float."""
    if whole:
        bits = np.nan_to_num(values).astype(np.int64).astype(np.uint32)
    else:
        bits = values.astype(np.float32).view(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.uint8)


def _read_binary(source: Source, header: PcdHeader, wanted: Wanted) -> Raw:
    dtype = np.dtype(
        {
            "names": [f"p{i}" for i in range(len(header.columns))],
            "formats": ["<" + column.code for column in header.columns],
            "offsets": [column.field_offset + column.within for column in header.columns],
            "itemsize": header.stride,
        }
    )
    return from_records(source.records(dtype, header.points, "the points"), header.points, wanted)


def _read_compressed(source: Source, header: PcdHeader, wanted: Wanted) -> Raw:
    """One LZF block that holds field after field, each for all points."""
    packed, size = struct.unpack("<II", source.take(8, "the block sizes"))
    if size != header.points * header.stride:
        raise source.fault(
            f"the header claims {header.points} points of {header.stride} bytes but the "
            f"compressed block holds {size} bytes; the file is damaged"
        )
    source.require(packed, "the compressed points")
    source.require_expansion(size, packed)
    data = lzf_decompress(source.take(packed, "the compressed points"), size)
    if data is None:
        raise source.fault("the compressed block is damaged; export or upload the file again")

    def column(index: int) -> NDArray[Any]:
        c = header.columns[index]
        start = c.field_offset * header.points + c.within
        return np.ndarray((header.points,), "<" + c.code, data, start, (c.field_size,))

    def stacked(columns: Triple) -> NDArray[Any]:
        return np.stack([column(index) for index in columns], axis=1)

    return Raw(
        stacked(wanted.points).astype(np.float64),
        stacked(wanted.colors) if wanted.colors else None,
        stacked(wanted.normals) if wanted.normals else None,
    )
