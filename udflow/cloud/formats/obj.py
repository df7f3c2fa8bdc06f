"""Vertices of Wavefront OBJ files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Wanted, from_table
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import HEADER_LIMIT, Source
from udflow.cloud.formats.text_lines import Block, numbered_blocks
from udflow.cloud.point_cloud import PointCloud

_VERTEX = re.compile(r"[ \t]*v[ \t]")


def looks_like_obj(lines: list[str]) -> bool:
    """Whether the first lines of a text are statements of an OBJ file."""
    return any(_VERTEX.match(line) and len(line.split()) >= 4 for line in lines)


def read_obj(source: Source) -> PointCloud:
    """The `v` lines of an OBJ file, with colours where they hold six numbers.

    Raises:
        InvalidCloud: no vertices, or a vertex line that is not made of numbers.
    """
    blocks = _vertices(source)
    first = next(blocks)
    has_colors = all(len(line.split()) >= 7 for line in first[1] if line)
    # Column 0 is the letter v; a fourth number alone is a weight.
    wanted = Wanted((1, 2, 3), (4, 5, 6) if has_colors else None)
    table = read_rows(source, chain([first], blocks), wanted.flat)
    return assemble(from_table(table, wanted), format=source.format)


def _vertices(source: Source) -> Iterator[Block]:
    for number, lines in numbered_blocks(source, line_limit=HEADER_LIMIT):
        # Other lines become blank, not fewer, so that messages name the right line.
        yield number, [line if _VERTEX.match(line) else "" for line in lines]
