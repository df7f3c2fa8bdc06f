"""The structure of compressed LAS points, checked before a decompressor believes it.

A layer of a few bytes may claim four gigabytes, and a decompressor that allocates what it is told
ends the process. The layout is that of the LASzip specification.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from udflow.cloud.formats.source import Source

_RECORD = struct.Struct("<HH4xI I 16x H")  # compressor, coder, options, chunk size, items
_ITEM = struct.Struct("<HHH")
_POINTWISE, _LAYERED = 2, 3
_VARIABLE = 2**32 - 1
# Layers by item type: point, rgb, rgb with infrared, wave packet; extra bytes have one each.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14


@dataclass(frozen=True)
class _Packing:
    layered: bool
    chunk_points: int
    layers: int


def require_sound_chunks(
    source: Source, record: bytes, first_byte: int, points: int, record_bytes: int
) -> None:
    """Check that chunk table and layers lie inside the file. Moves the source.

    Args:
        record: the LASzip record of the header.
        first_byte: where the compressed points begin.
        points, record_bytes: as the header says.

    Raises:
        InvalidCloud: unknown compression, or sizes that do not fit the file.
    """
    packing = _packing(source, record)
    _require_sound_table(source, first_byte, record_bytes)
    if packing.layered:
        source.seek(first_byte + 8)
        _walk_layers(source, packing, points, record_bytes)


def _packing(source: Source, record: bytes) -> _Packing:
    if len(record) < _RECORD.size:
        raise source.fault("the compression record is too short; the file is damaged")
    compressor, _, _, chunk_points, items = _RECORD.unpack_from(record)
    if compressor not in (_POINTWISE, _LAYERED) or chunk_points == 0:
        raise source.fault("unknown compression; save the file as LAS or with a newer LASzip")
    if len(record) < _RECORD.size + items * _ITEM.size:
        raise source.fault("the compression record is too short; the file is damaged")
    layers = 0
    for i in range(items):
        kind, size, _ = _ITEM.unpack_from(record, _RECORD.size + i * _ITEM.size)
        layers += size if kind == _EXTRA_BYTES else _LAYERS.get(kind, 0)
    return _Packing(compressor == _LAYERED, chunk_points, layers)


def _require_sound_table(source: Source, first_byte: int, record_bytes: int) -> None:
    """Every chunk holds at least one whole point, which bounds their number."""
    source.seek(first_byte)
    (table,) = struct.unpack("<q", source.take(8, "the chunk table"))
    if table == -1:  # written by a stream: the offset stands at the very end
        source.seek(source.size - 8)
        (table,) = struct.unpack("<q", source.take(8, "the chunk table"))
    source.seek(table)
    _, chunks = struct.unpack("<II", source.take(8, "the chunk table"))
    if chunks * record_bytes > source.size:
        raise source.fault(f"the chunk table claims {chunks} chunks; the file is damaged")


def _walk_layers(source: Source, packing: _Packing, points: int, record_bytes: int) -> None:
    """Chunk after chunk: a whole point, the count, the size of each layer, the layers."""
    sizes_of_layers = struct.Struct(f"<I{packing.layers}I")
    left = points
    while left > 0:
        source.take(record_bytes, "the compressed points")
        count, *sizes = sizes_of_layers.unpack(
            source.take(sizes_of_layers.size, "the compressed points")
        )
        fixed = packing.chunk_points != _VARIABLE
        if count == 0 or (fixed and count != min(packing.chunk_points, left)):
            raise source.fault("a chunk of compressed points has a wrong count; it is damaged")
        source.require(sum(sizes), "the compressed points")
        source.seek(source.position + sum(sizes))
        left -= count
