"""Lines of text with their numbers, for readers that point at the line that is wrong."""

from __future__ import annotations

from collections.abc import Iterator

from udflow.cloud.formats.source import HEADER_LINE_LIMIT, Source

Block = tuple[int, list[str]]


def numbered_blocks(
    source: Source, first_line: int = 1, line_limit: int = HEADER_LINE_LIMIT
) -> Iterator[Block]:
    """Blocks of lines with the number of their first line in the file."""
    number = first_line
    for lines in source.text_blocks(line_limit):
        yield number, lines
        number += len(lines)


def has_content(line: str) -> bool:
    """Whether a line holds more than white space and a comment."""
    text = line.strip()
    return bool(text) and not text.startswith("#")


def is_number(text: str) -> bool:
    """Whether NumPy's text parser takes this for a number."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text and text.isascii()


def shown(text: str) -> str:
    """Foreign text for a message: printable and short."""
    printable = text.strip()[:80].encode("ascii", "backslashreplace").decode("ascii")
    return repr(printable if len(printable) <= 40 else printable[:40] + "...")


class Lines:
    """Takes a known number of rows after another from a text body; blank lines do not count."""

    def __init__(self, source: Source, first_line: int, line_limit: int) -> None:
        self._source = source
        self._blocks = numbered_blocks(source, first_line, line_limit)
        self._held: Block | None = None

    def next_rows(self, count: int, what: str) -> Iterator[Block]:
        """The next `count` rows in blocks, with the blank lines among them.

        Raises:
            InvalidCloud: the file ends before.
        """
        found = 0
        while found < count:
            number, lines = self._next_block(count - found, what)
            rows = [i for i, line in enumerate(lines) if _has_text(line)]
            cut = rows[count - found] if len(rows) > count - found else len(lines)
            if cut < len(lines):
                self._held = number + cut, lines[cut:]
            found += min(len(rows), count - found)
            yield number, lines[:cut]

    def _next_block(self, missing: int, what: str) -> Block:
        held, self._held = self._held, None
        found = held or next(self._blocks, None)
        if found is None:
            raise self._source.fault(
                f"the file ends {missing} rows before the end of its {what[:40]} element; it is "
                "truncated or its header is wrong. Export or upload it again"
            )
        return found


def _has_text(line: str) -> bool:
    return bool(line) and not line.isspace()
