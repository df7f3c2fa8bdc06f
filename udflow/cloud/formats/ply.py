"""PLY: vertices of ascii and binary files of either byte order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw, Wanted, first_triple, from_table
from udflow.cloud.formats.ply_binary import read_vertices, skip_element
from udflow.cloud.formats.ply_header import Element, PlyHeader, read_ply_header
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import HEADER_LIMIT, Source
from udflow.cloud.formats.text_lines import Block, Lines, shown
from udflow.cloud.point_cloud import PointCloud

_COLORS = ("red green blue", "r g b", "diffuse_red diffuse_green diffuse_blue")
_NORMALS = ("nx ny nz", "normal_x normal_y normal_z")


def read_ply(source: Source) -> PointCloud:
    """The vertices of a PLY file with their colours and normals.

    Elements before the vertices are skipped, elements after them are checked to be complete.

    Raises:
        InvalidCloud: a damaged header, no vertices, or a file shorter than its header says.
    """
    header = read_ply_header(source)
    before, vertex, after = _around_vertices(source, header)
    wanted = _wanted(source, vertex)
    if not header.order:
        return assemble(_read_ascii(source, header, vertex, wanted), format=source.format)
    for element in before:
        skip_element(source, element, header.order)
    raw = read_vertices(source, vertex, header.order, wanted)
    for element in after:
        skip_element(source, element, header.order)
    warnings: tuple[str, ...] = ()
    if source.remaining:
        warnings = (f"{source.remaining} bytes after the end of the data were ignored",)
    return assemble(raw, format=source.format, warnings=warnings)


def _around_vertices(
    source: Source, header: PlyHeader
) -> tuple[list[Element], Element, list[Element]]:
    """The elements before the vertices, the vertices, and the elements after them."""
    names = [element.name for element in header.elements]
    name = next((n for n in ("vertex", "point") if n in names), None)
    if name is None:
        raise source.fault("the header names no vertex element; the file holds no points")
    at = names.index(name)
    elements = list(header.elements)
    source.require_count(elements[at].count)
    return elements[:at], elements[at], elements[at + 1 :]


def _wanted(source: Source, vertex: Element) -> Wanted:
    # A list keeps its place under an empty name, so that positions stay those of the file.
    names = ["" if p.count_type else p.name for p in vertex.properties]
    points = first_triple(names, [("x", "y", "z")])
    if points is None:
        raise source.fault("the vertices have no properties x, y and z; it is no cloud of points")
    colors = first_triple(names, [choice.split() for choice in _COLORS])
    normals = first_triple(names, [choice.split() for choice in _NORMALS])
    return Wanted(points, colors, normals)


# ---- ascii: one row a line


def _read_ascii(source: Source, header: PlyHeader, vertex: Element, wanted: Wanted) -> Raw:
    elements = [element for element in header.elements if element.properties]
    # A value takes at least a digit and a separator.
    source.require(sum(e.count * 2 * len(e.properties) for e in elements) - 1, "the rows")
    lines = Lines(source, first_line=header.lines + 1, line_limit=HEADER_LIMIT)
    table = np.empty((0, 0))
    for element in elements:
        rows = lines.next_rows(element.count, element.name)
        if element is vertex:
            columns: Sequence[int] = wanted.flat
            if element.has_lists:
                rows = _without_lists(source, element, rows, wanted)
                columns = range(len(columns))
            table = read_rows(source, rows, columns, expected=element.count)
        else:
            for _ in rows:  # only that they are there
                pass
    whole = wanted.colors is not None and vertex.properties[wanted.colors[0]].type[0] in "iu"
    return from_table(table, wanted, whole_colors=whole)


def _without_lists(
    source: Source, element: Element, blocks: Iterator[Block], wanted: Wanted
) -> Iterator[Block]:
    """The same rows, reduced to the wanted columns."""
    for number, lines in blocks:
        kept = []
        for offset, line in enumerate(lines):
            if not line.strip():
                kept.append("")
                continue
            cells = _scalars(element, line.split())
            if cells is None:
                raise source.fault(f"line {number + offset} does not fit the header: {shown(line)}")
            kept.append(" ".join(cells[column] for column in wanted.flat))
        yield number, kept


def _scalars(element: Element, cells: list[str]) -> list[str] | None:
    """One cell a property, "" for a list; None where the row does not fit the header."""
    found = []
    at = 0
    for prop in element.properties:
        if at >= len(cells):
            return None
        length = cells[at]
        found.append("" if prop.count_type else length)
        if prop.count_type:
            if not (length.isascii() and length.isdecimal() and len(length) < 10):
                return None
            at += int(length)
        at += 1
    return found if at == len(cells) else None
