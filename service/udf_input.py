"""Query points as they arrive: JSON, .npy, or bare numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from service.bodies import parse_json
from service.problems import Problem

JSON_POINTS = 100_000
BINARY_POINTS = 16_000_000
MAX_JSON_BYTES = 16 << 20
MAX_BINARY_BYTES = BINARY_POINTS * 24 + 65_536
MAX_NPY_HEADER = 10_000
NPY_MAGIC = b"\x93NUMPY"
SCAN_ROWS = 1 << 20
LARGEST = 1e30

Wire = Literal["json", "npy", "raw"]


@dataclass(frozen=True)
class Wanted:
    """Which columns beside the distance the caller asked for."""

    gradients: bool = False
    closest: bool = False
    valid: bool = False


@dataclass(frozen=True)
class Question:
    """Checked query points.

    points: (n, 3) finite numbers, perhaps mapped from a file; wire: the form they came in.
    """

    points: NDArray[Any]
    wanted: Wanted
    wire: Wire


def read_question(
    file: BinaryIO, size: int, headers: Mapping[str, str], dtype: str | None, wanted: Wanted
) -> Question:
    """The question in a body of `size` bytes; its form is told from the content first.

    dtype: of bare numbers, "float32" or "float64"; wanted: what the address asked for.

    Raises:
        Problem: the body is malformed, has too many points, or a point is not finite.
    """
    file.seek(0)
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    wire: Wire = "json"
    if file.read(len(NPY_MAGIC)) == NPY_MAGIC:
        wire, points = "npy", open_npy(file, size)
    elif dtype is not None or media_type == "application/octet-stream":
        wire, points = "raw", open_raw(file, size, dtype or "", headers.get("x-shape"))
    elif media_type == "application/x-npy":
        raise _bad_query("The body is no .npy file; write it with numpy.save.")
    elif size > MAX_JSON_BYTES:
        raise Problem("body_too_large", f"JSON may have {MAX_JSON_BYTES} bytes; send .npy instead.")
    else:
        file.seek(0)
        points, wanted = read_json(file.read(), wanted)
    require_usable(points)
    return Question(points, wanted, wire)


def read_json(data: bytes, wanted: Wanted) -> tuple[NDArray[np.float64], Wanted]:
    """Points and wishes from `{"points": [[x, y, z], ...], "gradients": ..., "closest": ...}`.

    wanted: what the address asked for, used where the body says nothing.

    Raises:
        Problem: not such an object, a row that is not three finite numbers, too many rows.
    """
    body = parse_json(data)
    if not isinstance(body, dict):
        raise _bad_query('Send an object: {"points": [[x, y, z], ...]}.')
    unknown = sorted(set(body) - {"points", "gradients", "closest"})
    if unknown:
        message = f'unknown key "{unknown[0]}"; known here: points, gradients, closest'
        raise Problem(
            "invalid_query", message, errors=[(f"#/{unknown[0]}", "unknown_key", message)]
        )
    flags = {name: body.get(name, getattr(wanted, name)) for name in ("gradients", "closest")}
    for name, value in flags.items():
        if not isinstance(value, bool):
            raise _bad_query(f"{name} must be true or false", f"#/{name}")
    rows = body.get("points")
    if not isinstance(rows, list):
        raise _bad_query("points must be a list of [x, y, z]", "#/points")
    _check_count(len(rows), JSON_POINTS, "Send more as .npy (application/x-npy).")
    return _rows_to_array(rows), Wanted(**flags)


def _rows_to_array(rows: list[Any]) -> NDArray[np.float64]:
    # numpy would read true and "1.5" as numbers; only a look at every value tells
    for index, row in enumerate(rows):
        if not isinstance(row, list) or len(row) != 3 or not all(map(_is_number, row)):
            raise bad_row(index, "it is not a list of three numbers")
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
    except OverflowError as error:
        raise _bad_query("A coordinate is too large for double precision.", "#/points") from error


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def open_npy(file: BinaryIO, size: int) -> NDArray[np.floating[Any]]:
    """The (n, 3) array of a .npy file, mapped, not loaded.

    Only the header is interpreted: a dtype that could hold Python objects is refused before any
    data is touched.

    Raises:
        Problem: no version 1 or 2 header, not (n, 3) numbers, or a body of another length than
            the header says.
    """
    file.seek(0)
    try:
        version = np.lib.format.read_magic(file)
        readers: dict[tuple[int, int], Callable[..., Any]] = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        if version not in readers:
            raise _bad_query("The .npy file is of an unknown version; save it with numpy.save.")
        shape, fortran, dtype = readers[version](file, max_header_size=MAX_NPY_HEADER)
    except (ValueError, TypeError) as error:
        raise _bad_query("The .npy header is damaged or incomplete.") from error
    if dtype.hasobject or dtype.kind not in "fiu" or dtype.itemsize not in (1, 2, 4, 8):
        raise _bad_query(f'The array holds "{dtype}"; send float64 or float32.')
    if len(shape) != 2 or shape[1] != 3 or shape[0] < 0:
        raise _bad_query(f"The array has shape {tuple(shape)}; send (n, 3).")
    return _mapped(file, size, file.tell(), dtype, shape[0], "F" if fortran else "C")


def open_raw(
    file: BinaryIO, size: int, dtype_name: str, shape: str | None
) -> NDArray[np.floating[Any]]:
    """The (n, 3) array of a body of bare little-endian numbers, mapped, not loaded.

    Args:
        dtype_name: "float32" or "float64".
        shape: the X-Shape header "n,3", or None to derive n from the length.

    Raises:
        Problem: another dtype or shape, or a body of another length.
    """
    if dtype_name not in ("float32", "float64"):
        raise _bad_query('The numbers are "float32" or "float64"; say which by ?dtype=.', "?dtype")
    dtype = np.dtype("<f4" if dtype_name == "float32" else "<f8")
    rows, rest = divmod(size, 3 * dtype.itemsize)
    if shape is not None:
        parts = [part.strip() for part in shape.strip("() ").split(",")]
        if len(parts) != 2 or parts[1] != "3" or not (parts[0].isascii() and parts[0].isdigit()):
            raise _bad_query("X-Shape must be n,3.")
        rows = int(parts[0])
    elif rest:
        raise _bad_query(f"The body of {size} bytes is no whole number of {dtype_name} triples.")
    return _mapped(file, size, 0, dtype, rows, "C")


def _mapped(
    file: BinaryIO,
    size: int,
    offset: int,
    dtype: np.dtype[Any],
    rows: int,
    order: Literal["C", "F"],
) -> NDArray[np.floating[Any]]:
    _check_count(rows, BINARY_POINTS, "Send them in several requests.")
    expected = offset + rows * 3 * dtype.itemsize
    if size != expected:
        raise _bad_query(
            f"The body has {size} bytes, but {rows} points of {dtype} need {expected}: it is "
            f"{'truncated' if size < expected else 'longer than it says'}."
        )
    if rows == 0:
        return np.empty((0, 3))
    return np.memmap(file, dtype=dtype, mode="r", offset=offset, shape=(rows, 3), order=order)


def require_usable(points: NDArray[Any]) -> None:
    """Raises a Problem that names the first row whose square would not be a number."""
    for start in range(0, len(points), SCAN_ROWS):
        rows = points[start : start + SCAN_ROWS]
        usable = (np.abs(rows) <= LARGEST).all(axis=1)  # false for NaN, too
        if not usable.all():
            index = start + int(np.argmin(usable))
            raise bad_row(index, f"a coordinate is not finite or beyond {LARGEST:g}")


def bad_row(index: int, why: str) -> Problem:
    """A 422 about one query point, counted from 0."""
    message = f"point {index} cannot be used: {why}"
    pointer = f"#/points/{index}"
    return Problem(
        "invalid_query", message, errors=[(pointer, "invalid_point", message)], row=index
    )


def _bad_query(message: str, pointer: str = "#") -> Problem:
    return Problem("invalid_query", message, errors=[(pointer, "invalid_value", message)])


def _check_count(count: int, limit: int, remedy: str) -> None:
    if count > limit:
        raise Problem("body_too_large", f"{count} points are more than {limit}. {remedy}")
