"""Vertices of STL files: corners of triangles, each distinct corner once."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.distinct import distinct
from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import Source
from udflow.cloud.formats.text_lines import Block, numbered_blocks
from udflow.cloud.point_cloud import PointCloud

_HEADER_BYTES = 80
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(r"[ \t]*vertex[ \t]", re.IGNORECASE)


def is_binary_stl(head: bytes, size: int) -> bool:
    """Whether the size of a file is the one its binary STL header asks for."""
    if len(head) < _HEADER_BYTES + 4:
        return False
    count = int.from_bytes(head[80:84], "little")
    return count > 0 and size == _HEADER_BYTES + 4 + count * _FACET.itemsize


def looks_like_ascii_stl(lines: list[str]) -> bool:
    """Whether the first lines of a text are those of an ascii STL file."""
    text = [line.strip().lower() for line in lines if line.strip()]
    return (
        bool(text)
        and text[0].startswith("solid")
        and any(line.startswith("facet") for line in text[:100])
    )


def read_binary_stl(source: Source) -> PointCloud:
    """The distinct corners of a binary STL file."""
    source.seek(_HEADER_BYTES)
    count = int.from_bytes(source.take(4, "the header"), "little")
    corners = np.empty((count, 3, 3))
    start = 0
    for chunk in source.records(_FACET, count, "the facets"):
        corners[start : start + len(chunk)] = chunk["corners"]
        start += len(chunk)
    return _from_corners(source, corners.reshape(-1, 3))


def read_ascii_stl(source: Source) -> PointCloud:
    """The distinct corners of an ascii STL file.

    Raises:
        InvalidCloud: no corners, or a corner that is not made of numbers.
    """
    return _from_corners(source, read_rows(source, _vertices(source), (1, 2, 3)))


def _from_corners(source: Source, corners: NDArray[np.float64]) -> PointCloud:
    return assemble(Raw(corners[distinct(corners)]), format=source.format)


def _vertices(source: Source) -> Iterator[Block]:
    for number, lines in numbered_blocks(source):
        # Other lines become blank, not fewer, so that messages name the right line.
        yield number, [line if _VERTEX.match(line) else "" for line in lines]
