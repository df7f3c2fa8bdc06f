"""XYZ, TXT, CSV, ASC and PTS: a table of numbers whose layout is found by looking."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Wanted, from_table, triple, wanted_by_value
from udflow.cloud.formats.rows import read_rows
from udflow.cloud.formats.source import Source
from udflow.cloud.formats.text_lines import is_number, numbered_blocks, shown
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import UnknownFormat

_SAMPLE_ROWS = 1000
_NAMES = {
    "x": ("x", "px", "easting", "pointx", "xcoord", "xcoordinate", "coordx"),
    "y": ("y", "py", "northing", "pointy", "ycoord", "ycoordinate", "coordy"),
    "z": ("z", "pz", "elevation", "pointz", "zcoord", "zcoordinate", "coordz"),
    "nx": ("nx", "normalx", "xnormal"),
    "ny": ("ny", "normaly", "ynormal"),
    "nz": ("nz", "normalz", "znormal"),
    "r": ("r", "red", "rf", "diffusered"),
    "g": ("g", "green", "gf", "diffusegreen"),
    "b": ("b", "blue", "bf", "diffuseblue"),
}
_ROLE = {alias: role for role, aliases in _NAMES.items() for alias in aliases}


@dataclass(frozen=True)
class Dialect:
    """How a line is cut into numbers. delimiter: None for any white space."""

    delimiter: str | None
    decimal_comma: bool = False

    def cells(self, line: str) -> list[str]:
        text = line.split("#")[0].strip()
        text = text.replace(",", ".") if self.decimal_comma else text
        cells = [cell.strip() for cell in text.split(self.delimiter)]
        while cells and not cells[-1]:
            cells.pop()
        return cells

    def numbers(self, line: str) -> int:
        """How many cells of the line are numbers."""
        return sum(map(is_number, self.cells(line)))


# Earlier ones win where two read a line equally well.
_DIALECTS = (
    Dialect(";"),
    Dialect(","),
    Dialect("\t"),
    Dialect(None),
    Dialect(";", decimal_comma=True),
    Dialect("\t", decimal_comma=True),
    Dialect(None, decimal_comma=True),
)


@dataclass(frozen=True)
class Layout:
    """Where the table begins and what its columns mean.

    Attributes:
        first_row: index of the first line of numbers.
        declared: rows announced by a count line (PTS), or None.
    """

    dialect: Dialect
    first_row: int
    declared: int | None
    wanted: Wanted
    warnings: tuple[str, ...] = ()


def looks_like_table(lines: list[str]) -> bool:
    """Whether the first lines of a file are a table of numbers, perhaps below a header."""
    return _find_table(lines) is not None


def read_text(source: Source) -> PointCloud:
    """A table of points in text.

    The layout comes from a header line (x, y, z, nx, ny, nz, r, g, b and their usual longer names)
    or, without one, from the values: three columns of length 1 are normals, three of whole
    numbers 0..255 are colours.

    Raises:
        InvalidCloud: a line that does not fit the table, or fewer rows than a count line says.
        UnknownFormat: the text is no table of numbers.
    """
    blocks = numbered_blocks(source)
    number, lines = next(blocks)
    layout = _layout(source, lines)
    table = read_rows(
        source,
        chain([(number + layout.first_row, lines[layout.first_row :])], blocks),
        layout.wanted.flat,
        delimiter=layout.dialect.delimiter,
        decimal_comma=layout.dialect.decimal_comma,
    )
    return assemble(
        from_table(table, layout.wanted),
        format=source.format,
        warnings=(*layout.warnings, *_compared(source, layout.declared, len(table))),
    )


def _compared(source: Source, declared: int | None, found: int) -> tuple[str, ...]:
    """What to say about the count line of a PTS file."""
    if declared is None or declared == found:
        return ()
    if declared > found:
        raise source.fault(
            f"the count line claims {declared} points but {found} follow; the file is truncated. "
            "Export or upload it again"
        )
    return (f"the count line claims {declared} points but {found} follow; all were read",)


def _find_table(lines: list[str]) -> tuple[int, Dialect] | None:
    """The first line of three or more numbers, at most three lines of other text above it."""
    others = 0
    for index, line in enumerate(lines):
        if _is_comment(line):
            continue
        best = max(_DIALECTS, key=lambda d: (d.numbers(line), -len(d.cells(line))))
        if best.numbers(line) >= 3:
            return index, best
        others += 1
        if others > 3:
            return None
    return None


def _layout(source: Source, lines: list[str]) -> Layout:
    found = _find_table(lines)
    if found is None:
        first = next((line for line in lines if not _is_comment(line)), "")
        raise UnknownFormat(
            f"the file is text but no table of points; it begins {shown(first)}. "
            "Each line needs at least three numbers: x y z"
        )
    first_row, dialect = found
    header = [line for line in lines[:first_row] if line.strip()]
    declared = next((int(line) for line in header if line.strip().isdecimal()), None)
    if declared is not None:
        source.require_count(declared)
    rows = lines[first_row : first_row + _SAMPLE_ROWS]
    roles = _header_roles(header, dialect, len(dialect.cells(rows[0])))
    points = triple(roles, "xyz")
    if points is not None:
        wanted = Wanted(points, triple(roles, "rgb"), triple(roles, ("nx", "ny", "nz")))
        return Layout(dialect, first_row, declared, wanted)
    wanted = wanted_by_value(_sample(rows, dialect))
    return Layout(dialect, first_row, declared, wanted, _misunderstood(header))


def _header_roles(header: list[str], dialect: Dialect, width: int) -> list[str]:
    """The column roles of the last header line that names x, "" where a name is unknown."""
    for line in reversed(header):
        text = line.strip().lstrip("#/% ")
        for delimiter in (dialect.delimiter, ",", ";", "\t", None):
            names = [name for name in text.split(delimiter) if name.strip()]
            roles = [_ROLE.get(_plain(name), "") for name in names]
            if len(roles) == width and "x" in roles:
                return roles
    return []


def _misunderstood(header: list[str]) -> tuple[str, ...]:
    """A warning where a header line stands above the table but names no columns we know."""
    if all(_is_comment(line) or line.strip().isdecimal() for line in header):
        return ()
    return ("the header line names no x, y and z: the first three columns were taken",)


def _plain(name: str) -> str:
    """A column name reduced to its letters: "Normal_X [m]" and '"normal x"' are normalx."""
    return "".join(c for c in name.split("[")[0].split("(")[0].lower() if c.isalpha())


def _sample(rows: list[str], dialect: Dialect) -> NDArray[np.float64]:
    """The leading rows that have as many cells as the first, text cells as NaN."""
    cut = [dialect.cells(line) for line in rows if not _is_comment(line)]
    width = len(cut[0])
    return np.array(
        [
            [float(cell) if is_number(cell) else np.nan for cell in cells]
            for cells in cut
            if len(cells) == width
        ]
    )


def _is_comment(line: str) -> bool:
    text = line.strip()
    return not text or text.startswith(("#", "//", "%"))
