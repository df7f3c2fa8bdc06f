"""multipart/form-data as a stream: the file goes straight to its place, without a second copy."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from service.problems import Problem, invalid

MAX_FIELD_BYTES = 256 * 1024
MAX_PARTS = 16


@dataclass
class Form:
    """What a form brought besides the bytes of its file.

    Attributes:
        fields: text fields by name.
        filename: the file's name as sent, None if there was no file.
    """

    fields: dict[str, str] = field(default_factory=dict)
    filename: str | None = None


class _Parts:
    """Collects the parser's callbacks; file bytes wait in `pending` until they are written."""

    def __init__(self) -> None:
        self.form = Form()
        self.pending: list[bytes] = []
        self.ended = False
        self._parts = 0
        self._header = [b"", b""]
        self._disposition = b""
        self._name = ""
        self._is_file = False
        self._text = b""

    def on_part_begin(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise Problem("malformed_request", f"The form has more than {MAX_PARTS} parts.")
        self._disposition, self._text = b"", b""

    def on_header_begin(self) -> None:
        self._header = [b"", b""]

    def on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header[0] += data[start:end]

    def on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header[1] += data[start:end]

    def on_header_end(self) -> None:
        if self._header[0].lower() == b"content-disposition":
            self._disposition = self._header[1]

    def on_headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition.decode("latin-1"))
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        self._is_file = b"filename" in options
        if not self._name:
            raise Problem("malformed_request", "A part of the form has no name.")
        if not self._is_file:
            return
        if self._name != "file":
            raise invalid(f"#/{self._name}", "unknown_key", 'send the scan in the part "file"')
        if self.form.filename is not None:
            raise invalid("#/file", "invalid_value", "send one file per request")
        self.form.filename = options[b"filename"].decode("utf-8", "replace")

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._is_file:
            self.pending.append(data[start:end])
            return
        self._text += data[start:end]
        if len(self._text) > MAX_FIELD_BYTES:
            message = f"{self._name} is longer than {MAX_FIELD_BYTES} bytes"
            raise Problem("body_too_large", message)

    def on_part_end(self) -> None:
        if self._is_file:
            return
        if self._name in self.form.fields:
            raise invalid(f"#/{self._name}", "invalid_value", f"{self._name} was sent twice")
        try:
            self.form.fields[self._name] = self._text.decode("utf-8")
        except UnicodeDecodeError as error:
            raise invalid(f"#/{self._name}", "invalid_value", "the value is not UTF-8") from error

    def on_end(self) -> None:
        self.ended = True


async def read_form(
    content_type: str,
    body: AsyncIterator[bytes],
    write_file: Callable[[bytes], Awaitable[None]],
) -> Form:
    """Reads a form, handing the bytes of the part "file" to `write_file` as they arrive.

    Raises:
        Problem: the form is malformed, incomplete or has unexpected parts.
    """
    _, options = parse_options_header(content_type)
    if not options.get(b"boundary"):
        raise Problem("malformed_request", "The multipart Content-Type names no boundary.")
    parts = _Parts()
    names = [name for name in dir(parts) if name.startswith("on_")]
    try:
        callbacks = {name: getattr(parts, name) for name in names}
        parser = MultipartParser(options[b"boundary"], callbacks)  # type: ignore[arg-type]
        async for chunk in body:
            parser.write(chunk)
            for piece in parts.pending:
                await write_file(piece)
            parts.pending.clear()
    except FormParserError as error:
        raise Problem("malformed_request", "The multipart body is malformed.") from error
    if not parts.ended:
        raise Problem("malformed_request", "The multipart body ends before its last boundary.")
    return parts.form
