"""Rows of numbers in text, parsed in blocks by NumPy's C parser and collected without copies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.source import MAX_POINTS, Source
from udflow.cloud.formats.text_lines import Block, has_content, is_number, shown


class Rows:
    """A growing (n, columns) float64 array. Growth remaps memory instead of doubling it."""

    def __init__(self, columns: int) -> None:
        self._data = np.empty((1024, columns))
        self.count = 0

    def extend(self, block: NDArray[np.float64]) -> None:
        """Append the rows of a block."""
        end = self.count + len(block)
        if end > len(self._data):
            grown = max(end, len(self._data) * 3 // 2)
            self._data.resize((grown, self._data.shape[1]), refcheck=False)
        self._data[self.count : end] = block
        self.count = end

    def finish(self) -> NDArray[np.float64]:
        """The collected rows; the collector must not be used afterwards."""
        self._data.resize((self.count, self._data.shape[1]), refcheck=False)
        return self._data


def read_rows(
    source: Source,
    blocks: Iterable[Block],
    columns: Sequence[int],
    *,
    delimiter: str | None = None,
    decimal_comma: bool = False,
    expected: int | None = None,
) -> NDArray[np.float64]:
    """The given columns of a table in text.

    Args:
        source: for messages.
        columns: which columns, in this order.
        delimiter: None for any white space.
        expected: rows declared by a header; further lines are left unread.

    Raises:
        InvalidCloud: a row lacks a column or holds something that is no number; fewer rows than
            expected.
    """
    rows = Rows(len(columns))
    for number, lines in blocks:
        used = [line.replace(",", ".") for line in lines] if decimal_comma else lines
        limit = None if expected is None else expected - rows.count
        rows.extend(_parse(source, (number, used), columns, delimiter, limit))
        if rows.count > MAX_POINTS:
            raise source.fault(f"more than {MAX_POINTS} points; thin the scan out first")
        if rows.count == expected:
            break
    if expected is not None and rows.count < expected:
        raise source.fault(
            f"the header claims {expected} points but {rows.count} follow; the file is "
            "truncated or its header is wrong. Export or upload it again"
        )
    return rows.finish()


def _parse(
    source: Source, block: Block, columns: Sequence[int], delimiter: str | None, limit: int | None
) -> NDArray[np.float64]:
    lines = block[1]
    if limit is not None and len(lines) > limit:
        lines = list(islice(filter(has_content, lines), limit))
    if not any(map(has_content, lines)):
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(lines, delimiter=delimiter, usecols=columns, ndmin=2, dtype=np.float64)
    except ValueError as error:
        said = _what_is_wrong(block, columns, delimiter) or f"unreadable numbers: {error}"
        raise source.fault(said) from error


def _what_is_wrong(block: Block, columns: Sequence[int], delimiter: str | None) -> str | None:
    """The first line that does not parse, in words."""
    number, lines = block
    for offset, line in enumerate(lines):
        if not has_content(line):
            continue
        cells = line.split("#")[0].split(delimiter)
        if len(cells) <= max(columns):
            return (
                f"line {number + offset} has {len(cells)} columns where at least "
                f"{max(columns) + 1} are needed: {shown(line)}"
            )
        wrong = [column for column in columns if not is_number(cells[column])]
        if wrong:
            return f"line {number + offset} holds {shown(cells[wrong[0]])} where a number belongs"
    return None
