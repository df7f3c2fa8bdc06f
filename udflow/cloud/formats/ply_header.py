"""The header of a PLY file: what its elements are made of and how many there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from udflow.cloud.formats.source import Source
from udflow.cloud.formats.text_lines import shown

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """One property. type: NumPy code of a value; count_type: of a list's length, None: scalar."""

    name: str
    type: str
    count_type: str | None = None


@dataclass(frozen=True)
class Element:
    """A table of `count` rows."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(p.count_type for p in self.properties)

    @property
    def smallest(self) -> int:
        """Bytes of one row whose lists are empty."""
        return sum(int((p.count_type or p.type)[1]) for p in self.properties)

    def dtype(self, order: str) -> np.dtype[np.void]:
        """One row without lists; fields are named by position, since names may be anything."""
        return np.dtype([(f"p{i}", order + p.type) for i, p in enumerate(self.properties)])

    def columns(self, *names: str) -> tuple[int, int, int] | None:
        """The positions of three scalar properties, or None unless all are there."""
        found = {p.name: i for i, p in enumerate(self.properties) if p.count_type is None}
        if not set(names) <= set(found):
            return None
        a, b, c = (found[name] for name in names)
        return a, b, c


@dataclass(frozen=True)
class PlyHeader:
    """order: "<", ">" or "" for ascii; lines: how many lines the header has."""

    order: str
    elements: tuple[Element, ...]
    lines: int


def read_ply_header(source: Source) -> PlyHeader:
    """The header; afterwards the source stands at the first byte of the body.

    Raises:
        InvalidCloud: longer than 64 KiB, no end, unknown words, negative or absurd counts.
    """
    order: str | None = None
    elements: list[Element] = []
    lines = 0
    while True:
        words = source.header_line().split()
        lines += 1
        keyword = words[0] if words else ""
        if keyword == "end_header":
            break
        if keyword == "format":
            order = _order(source, words)
        elif keyword == "element":
            elements.append(_element(source, words))
        elif keyword == "property":
            elements.append(_with_property(source, elements, words))
        elif keyword not in ("ply", "comment", "obj_info", ""):
            raise source.fault(f"the header holds {shown(keyword)}, which is no PLY keyword")
    if order is None:
        raise source.fault("the header has no format line; the file is damaged")
    return PlyHeader(order, tuple(elements), lines)


def _order(source: Source, words: list[str]) -> str:
    if len(words) < 2 or words[1] not in _ORDERS:
        raise source.fault(
            f"unknown format {shown(' '.join(words[1:]))}; known are {', '.join(_ORDERS)}"
        )
    return _ORDERS[words[1]]


def _element(source: Source, words: list[str]) -> Element:
    if len(words) != 3:
        raise source.fault(f"damaged element line {shown(' '.join(words))}")
    return Element(words[1].lower(), source.whole(words[2], f"the count of {words[1]}"), ())


def _with_property(source: Source, elements: list[Element], words: list[str]) -> Element:
    """The last element with one property more."""
    if not elements:
        raise source.fault("a property stands before the first element; the file is damaged")
    element = elements.pop()
    if len(words) == 5 and words[1] == "list":
        count_type, item = _type(source, words[2]), _type(source, words[3])
        if count_type.startswith("f"):
            raise source.fault("a list's length is a fraction; the file is damaged")
        added = Property(words[4].lower(), item, count_type)
    elif len(words) == 3:
        added = Property(words[2].lower(), _type(source, words[1]))
    else:
        raise source.fault(f"damaged property line {shown(' '.join(words))}")
    return Element(element.name, element.count, (*element.properties, added))


def _type(source: Source, word: str) -> str:
    if word not in _TYPES:
        raise source.fault(f"unknown type {shown(word)}; known are {', '.join(_TYPES)}")
    return _TYPES[word]
