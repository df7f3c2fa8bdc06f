"""The XML section of an E57 file: which scans there are, where, and of what columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.source import Source

XML_LIMIT = 16 * 1024 * 1024
_MAX_ELEMENTS = 500_000
_MAX_DEPTH = 64
_FIRST, _LAST = -(2**63), 2**63 - 1
Kind = Literal["float32", "float64", "integer", "other"]


@dataclass(frozen=True)
class Column:
    """One value of every point.

    minimum, maximum: of the stored whole numbers; value = stored * scale + offset.
    """

    name: str
    kind: Kind
    minimum: int = _FIRST
    maximum: int = _LAST
    scale: float = 1.0
    offset: float = 0.0

    @property
    def bits(self) -> int:
        """That one value takes in its stream; of "other" columns nothing is known."""
        if self.kind == "integer":
            return (self.maximum - self.minimum).bit_length()
        return 64 if self.kind == "float64" else 32


@dataclass(frozen=True)
class ScanPart:
    """One scan of the file.

    physical: where its points begin in the file; columns: all, in the order of their streams;
    rotation (3, 3) and translation (3,): from its own frame into that of the file; color_range:
    darkest and brightest value, None if the file does not say.
    """

    points: int
    physical: int
    columns: tuple[Column, ...]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    color_range: tuple[float, float] | None


def read_parts(source: Source, text: bytes) -> list[ScanPart]:
    """The scans that an XML section lists.

    Raises:
        InvalidCloud: it is no XML, defines entities, is nested beyond reason, or lacks a value.
    """
    listed = _parsed(source, text).find("data3D")
    if listed is None:
        raise source.fault("the file lists no scans; choose one that holds points")
    return [_part(source, scan) for scan in listed.iterfind("vectorChild")]


def _parsed(source: Source, text: bytes) -> Element:
    builder = TreeBuilder()
    depth = count = 0

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MAX_DEPTH or count > _MAX_ELEMENTS:
            raise source.fault("the XML section is nested or long beyond reason")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def refuse(*_: object) -> None:
        raise source.fault("the XML section has a document type, which is never read")

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse  # entities are defined there
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise source.fault(f"the XML section is damaged: {error}") from error
    return builder.close()


def _part(source: Source, scan: Element) -> ScanPart:
    points = scan.find("points")
    prototype = None if points is None else points.find("prototype")
    if points is None or prototype is None:
        raise source.fault("a scan has no points or does not say what they are made of")
    for codec in points.iterfind("codecs/*"):
        if codec.find("bitPackCodec") is None:
            raise source.fault("the points are packed in an unknown way; export without packing")
    rotation, translation = _pose(source, scan)
    return ScanPart(
        source.whole(points.get("recordCount", ""), "the number of points"),
        source.whole(points.get("fileOffset", ""), "the place of the points"),
        tuple(_columns(source, prototype)),
        rotation,
        translation,
        _color_range(source, scan),
    )


def _columns(source: Source, parent: Element) -> Iterator[Column]:
    """The leaves, depth first: each has a stream of its own."""
    for item in parent:
        kind = item.get("type")
        if kind in ("Structure", "Vector"):
            yield from _columns(source, item)
        elif kind == "Float":
            single = item.get("precision") == "single"
            yield Column(item.tag, "float32" if single else "float64")
        elif kind in ("Integer", "ScaledInteger"):
            yield _integer(source, item)
        else:
            yield Column(item.tag, "other")


def _integer(source: Source, item: Element) -> Column:
    limits = [item.get("minimum", str(_FIRST)), item.get("maximum", str(_LAST))]
    try:
        low, high = (int(text) for text in limits if len(text) <= 20)
    except ValueError:
        low, high = 0, -1
    scale, offset = 1.0, 0.0
    if item.get("type") == "ScaledInteger":
        scale = _real(source, item.get("scale", "1"))
        offset = _real(source, item.get("offset", "0"))
    if not (_FIRST <= low <= high <= _LAST and scale != 0.0):
        raise source.fault(f"the limits of {item.tag[:40]} contradict themselves; it is damaged")
    return Column(item.tag, "integer", low, high, scale, offset)


def _pose(source: Source, scan: Element) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    turn = scan.find("pose/rotation")
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    if turn is not None:
        w, x, y, z = (_value(source, turn, name) for name in "wxyz")
    length = float(np.sqrt(w * w + x * x + y * y + z * z))
    if not 0.9 < length < 1.1:
        raise source.fault("the rotation of a scan is none; the file is damaged")
    w, x, y, z = (part / length for part in (w, x, y, z))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    moved = scan.find("pose/translation")
    place = [0.0, 0.0, 0.0] if moved is None else [_value(source, moved, name) for name in "xyz"]
    return rotation, np.array(place)


def _color_range(source: Source, scan: Element) -> tuple[float, float] | None:
    limits = scan.find("colorLimits")
    if limits is None:
        return None
    low, high = (
        [_value(source, limits, f"color{name}{end}") for name in ("Red", "Green", "Blue")]
        for end in ("Minimum", "Maximum")
    )
    return (min(low), max(high)) if min(low) < max(high) else None


def _value(source: Source, parent: Element, name: str) -> float:
    """The number in a child, 0 where it is left out or empty, as the standard has it."""
    item = parent.find(name)
    text = "" if item is None or item.text is None else item.text.strip()
    number = _real(source, text or "0")
    if item is not None and item.get("type") == "ScaledInteger":
        return number * _real(source, item.get("scale", "1")) + _real(
            source, item.get("offset", "0")
        )
    return number


def _real(source: Source, text: str) -> float:
    try:
        number = float(text[:64])
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise source.fault(f"the XML section holds {text[:40]!r} where a number belongs")
    return number
