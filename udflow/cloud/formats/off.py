"""Vertices of OFF files (Object File Format), with the colours of COFF."""

from __future__ import annotations

import re

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Wanted, from_table
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import HEADER_LIMIT, Source
from udflow.cloud.formats.text_lines import Lines, has_content, shown
from udflow.cloud.point_cloud import PointCloud

# ST, C, N, 4 and n announce texture, colour, normals, homogeneous and n-dimensional vertices.
_KEYWORD = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF\b")


def looks_like_off(lines: list[str]) -> bool:
    """Whether the first line with content starts an OFF file."""
    return bool(_KEYWORD.match(next(filter(has_content, lines), "").strip()))


def read_off(source: Source) -> PointCloud:
    """The vertices of an ascii OFF file.

    Raises:
        InvalidCloud: a binary, homogeneous or n-dimensional file, or fewer vertices than the
            counts line says.
    """
    lines = 0
    words: list[str] = []
    while len(words) < 2:  # keyword, then counts, on one line or two
        line = source.header_line()
        lines += 1
        words += line.split("#")[0].split()
    kind = _KEYWORD.match(words[0])
    if kind is None or kind[4] or kind[5] or words[1] == "BINARY":
        raise source.fault(f"{shown(' '.join(words[:2]))} is not read; save an ascii OFF file")
    count = source.whole(words[1], "the number of vertices")
    source.require_count(count)
    source.require(count * 6 - 1, "the vertices")
    normals = (3, 4, 5) if kind[3] else None
    after = 6 if kind[3] else 3
    colors = (after, after + 1, after + 2) if kind[2] else None
    wanted = Wanted((0, 1, 2), colors, normals)
    rows = Lines(source, lines + 1, HEADER_LIMIT).next_rows(count, "vertex")
    table = read_rows(source, rows, wanted.flat, expected=count)
    return assemble(from_table(table, wanted), format=source.format)
