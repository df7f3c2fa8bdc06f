"""The header of a PCD file: its fields and where each of their columns lies."""

from __future__ import annotations

from dataclasses import dataclass

from udflow.cloud.formats.source import Source
from udflow.cloud.formats.text_lines import shown

_TYPES = {
    ("F", 2): "f2", ("F", 4): "f4", ("F", 8): "f8",
    ("I", 1): "i1", ("I", 2): "i2", ("I", 4): "i4", ("I", 8): "i8",
    ("U", 1): "u1", ("U", 2): "u2", ("U", 4): "u4", ("U", 8): "u8",
}  # fmt: skip
_WORDS = {"VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT",
          "POINTS", "DATA"}  # fmt: skip
_MAX_COLUMNS = 4096


@dataclass(frozen=True)
class Column:
    """One number of a point.

    Attributes:
        name: of its field, lower case.
        code: NumPy code of its type, little-endian.
        text: its position in a line of text, -1 for a byte of a packed colour.
        field_offset, field_size: bytes of its field within a point (a field of COUNT n holds n).
        within: bytes from the start of the field.
    """

    name: str
    code: str
    text: int
    field_offset: int
    field_size: int
    within: int


@dataclass(frozen=True)
class PcdHeader:
    """columns: all numbers of a point, then red, green and blue bytes of a packed colour."""

    columns: tuple[Column, ...]
    stride: int
    points: int
    data: str
    lines: int


def read_pcd_header(source: Source) -> PcdHeader:
    """The header; afterwards the source stands at the first byte of the body.

    Raises:
        InvalidCloud: words or types that PCD does not know, or counts that contradict each other.
    """
    found: dict[str, list[str]] = {}
    lines = 0
    while "DATA" not in found:
        words = source.header_line().split()
        lines += 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _WORDS:
            raise source.fault(f"the header holds {shown(words[0])}, which is no PCD keyword")
        found[words[0]] = words[1:]
    data = " ".join(found["DATA"])
    if data not in ("ascii", "binary", "binary_compressed"):
        raise source.fault(
            f"unknown DATA {shown(data)}; known are ascii, binary and binary_compressed"
        )
    columns, stride = _columns(source, found)
    return PcdHeader(columns, stride, _points(source, found), data, lines)


def _points(source: Source, found: dict[str, list[str]]) -> int:
    numbers = {
        key: source.whole(found[key][0] if found[key] else "", key)
        for key in ("WIDTH", "HEIGHT", "POINTS")
        if key in found
    }
    grid = numbers["WIDTH"] * numbers.get("HEIGHT", 1) if "WIDTH" in numbers else None
    points = numbers.get("POINTS", grid)
    if points is None:
        raise source.fault("the header names neither POINTS nor WIDTH; the file is damaged")
    if grid is not None and points != grid:
        raise source.fault(f"POINTS is {points} but WIDTH x HEIGHT is {grid}; correct the header")
    return points


def _columns(source: Source, found: dict[str, list[str]]) -> tuple[tuple[Column, ...], int]:
    names = found.get("FIELDS") or found.get("COLUMNS") or []
    sizes, types = found.get("SIZE", []), found.get("TYPE", [])
    counts = found.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise source.fault("FIELDS, SIZE, TYPE and COUNT are not of one length; correct the header")
    columns: list[Column] = []
    packed: list[Column] = []
    offset = text = 0
    for name, kind, size_text, count_text in zip(names, types, sizes, counts, strict=True):
        size, count = source.whole(size_text, "SIZE"), source.whole(count_text, "COUNT")
        code = _TYPES.get((kind.upper(), size))
        if code is None:
            raise source.fault(f"no number has TYPE {shown(kind)} and SIZE {size}")
        if len(columns) + count > _MAX_COLUMNS:
            raise source.fault(f"a point has more than {_MAX_COLUMNS} numbers; correct the header")
        field = (offset, size * count)
        for i in range(count):
            columns.append(Column(name.lower(), code, text + i, *field, i * size))
        if name.lower() in ("rgb", "rgba") and size == 4 and count == 1:
            # 0xAARRGGBB, stored with its lowest byte first
            packed = [
                Column(f"packed_{channel}", "u1", -1, *field, 2 - i)
                for i, channel in enumerate("rgb")
            ]
        offset += size * count
        text += count
    return (*columns, *packed), offset
