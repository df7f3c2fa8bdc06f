"""The body of a binary PLY file: fixed rows at once, rows with lists one by one."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from udflow.cloud.formats.columns import Raw, Wanted, from_records
from udflow.cloud.formats.ply_header import Element
from udflow.cloud.formats.source import Source

_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}


def read_vertices(source: Source, vertex: Element, order: str, wanted: Wanted) -> Raw:
    """The vertices that begin where the source stands; the source moves behind them."""
    source.require(vertex.count * vertex.smallest, "the vertices")
    if not vertex.has_lists:
        dtype = vertex.dtype(order)
        return from_records(
            source.records(dtype, vertex.count, "the vertices"), vertex.count, wanted
        )
    start = source.position
    data = source.take(source.remaining, "the vertices")
    kept, end = _without_lists(source, vertex, order, data)
    source.seek(start + end)
    scalars = [
        (f"p{i}", order + p.type) for i, p in enumerate(vertex.properties) if not p.count_type
    ]
    return from_records([np.frombuffer(kept, np.dtype(scalars))], vertex.count, wanted)


def skip_element(source: Source, element: Element, order: str) -> None:
    """Move the source behind an element, whose rows must all be there."""
    what = f"the rows of element {element.name[:40]}"
    source.require(element.count * element.smallest, what)
    start = source.position
    if not element.has_lists:
        source.seek(start + element.count * element.smallest)
    elif element.count:
        data = source.take(source.remaining, what)
        end = _end_of_equal_lists(element, order, data)
        if end is None:
            end = _without_lists(source, element, order, data)[1]
        source.seek(start + end)


def _end_of_equal_lists(element: Element, order: str, data: bytes) -> int | None:
    """Where an element ends whose only property is a list of one length (faces of triangles).

    None where that is not so.
    """
    if len(element.properties) != 1:
        return None
    prop = element.properties[0]
    count = np.dtype(order + (prop.count_type or ""))
    if len(data) < count.itemsize:
        return None
    length = int(np.frombuffer(data, count, 1)[0])
    stride = count.itemsize + length * int(prop.type[1])
    if length < 0 or element.count * stride > len(data):
        return None
    lengths = np.ndarray((element.count,), count, data, strides=(stride,))
    return element.count * stride if bool((lengths == length).all()) else None


@dataclass(frozen=True)
class _Step:
    """Part of a row: `fixed` bytes of scalars, then a list unless `length` is None."""

    fixed: int
    length: struct.Struct | None
    item: int


def _steps(element: Element, order: str) -> list[_Step]:
    steps = []
    fixed = 0
    for prop in element.properties:
        size = int(prop.type[1])
        if prop.count_type is None:
            fixed += size
        else:
            steps.append(_Step(fixed, struct.Struct(order + _STRUCT[prop.count_type]), size))
            fixed = 0
    return [*steps, _Step(fixed, None, 0)]


def _without_lists(
    source: Source, element: Element, order: str, data: bytes
) -> tuple[bytearray, int]:
    """The rows with their lists left out, and where the element ends in `data`.

    Raises:
        InvalidCloud: a negative list length, or rows beyond the end of the file.
    """
    steps = [
        (s.fixed, s.length, s.length.size if s.length else 0, s.item)
        for s in _steps(element, order)
    ]
    kept = bytearray()
    at, size = 0, len(data)
    try:
        for _ in range(element.count):
            for fixed, length, length_size, item in steps:
                if fixed:
                    kept += data[at : at + fixed]
                    at += fixed
                if length is not None:
                    (entries,) = length.unpack_from(data, at)
                    if entries < 0:
                        raise source.fault(
                            f"element {element.name[:40]} has a list of {entries} entries; "
                            "the file is damaged"
                        )
                    at += length_size + entries * item
            if at > size:
                break
    except struct.error:
        at = size + 1
    if at > size:
        raise source.fault(
            f"the file ends inside element {element.name[:40]}; it is truncated or written in "
            "the other byte order. Export or upload it again"
        )
    return kept, at
