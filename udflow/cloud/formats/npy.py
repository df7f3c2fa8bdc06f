"""NPY and NPZ: arrays of points. Only plain numbers are read, never pickled objects."""

from __future__ import annotations

import ast
import lzma
import re
import zipfile
import zlib
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw, wanted_by_value
from udflow.cloud.formats.source import HEADER_LIMIT, Source
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

MAGIC = b"\x93NUMPY"
_PLAIN_NUMBER = re.compile(r"[<>|=]?([fiu][1248]|f16|b1)")
_POINT_KEYS = ("points", "xyz", "vertices", "positions", "pos", "coords", "pts", "arr_0")
_COLOR_KEYS = ("colors", "colours", "color", "rgb")
_NORMAL_KEYS = ("normals", "normal")
_MAX_COLUMNS = 64
_MAX_MEMBERS = 1000
_ZIP_FAULTS = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, RuntimeError,
    NotImplementedError, ValueError, KeyError,
)  # fmt: skip


def read_npy(source: Source) -> PointCloud:
    """An (n, 3) array of points; further columns may hold colours and normals.

    Raises:
        InvalidCloud: pickled objects, named fields, another shape, or a truncated file.
    """
    raw = _split(source, read_array(source))
    warnings: tuple[str, ...] = ()
    if source.remaining:
        warnings = (f"{source.remaining} bytes after the end of the data were ignored",)
    return assemble(raw, format=source.format, warnings=warnings)


def read_npz(source: Source, file: BinaryIO) -> PointCloud:
    """The points of an NPZ archive, with `colors` and `normals` where it has them.

    Raises:
        InvalidCloud: no array of points, several without a usual name, or a damaged archive.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            return _read_members(source, archive)
    except InvalidCloud:
        raise
    except _ZIP_FAULTS as error:
        raise source.fault("the archive is damaged; save it again") from error


def read_array(source: Source) -> NDArray[Any]:
    """The array of an NPY stream, checked against the bytes that are there.

    Raises:
        InvalidCloud: not a two-dimensional array of plain numbers, or a truncated file.
    """
    dtype, fortran, shape = _read_header(source)
    if len(shape) != 2 or not 3 <= shape[1] <= _MAX_COLUMNS:
        remedy = "save an array of shape (number of points, 3)"
        if len(shape) == 2 and shape[0] == 3:
            remedy = "save its transpose"
        raise source.fault(f"the array has shape {shape}, which is no list of points; {remedy}")
    count = shape[0] * shape[1]
    data = source.take(count * dtype.itemsize, "the numbers")
    array = np.frombuffer(data, dtype)
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def _read_header(source: Source) -> tuple[np.dtype[Any], bool, tuple[int, ...]]:
    start = source.take(8, "the header")
    if not start.startswith(MAGIC) or start[6] not in (1, 2, 3):
        raise source.fault("the header is damaged; save the array again")
    width = 2 if start[6] == 1 else 4
    length = int.from_bytes(source.take(width, "the header"), "little")
    if length > HEADER_LIMIT:
        raise source.fault(f"the header claims {length} bytes; at most {HEADER_LIMIT} are read")
    text = source.take(length, "the header").decode("latin-1")
    try:
        header = ast.literal_eval(text.strip())
        descr, fortran, shape = header["descr"], header["fortran_order"], header["shape"]
        plain = all(isinstance(n, int) and 0 <= n < 2**48 for n in shape)
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError) as error:
        raise source.fault("the header is damaged; save the array again") from error
    if not plain or not isinstance(shape, tuple):
        raise source.fault("the header holds no usable shape; save the array again")
    if isinstance(descr, list):
        raise source.fault(
            "the array has named fields; save its coordinates as a plain (n, 3) array"
        )
    if not isinstance(descr, str) or not _PLAIN_NUMBER.fullmatch(descr):
        raise source.fault(
            f"the array holds {str(descr)[:20]!r}, which are no plain numbers; "
            "save it as float32 or float64 (objects and pickles are never read)"
        )
    return np.dtype(descr), bool(fortran), shape


def _split(source: Source, array: NDArray[Any]) -> Raw:
    source.require_count(len(array))
    wanted = wanted_by_value(array[:1000].astype(np.float64))
    return Raw(
        array[:, wanted.points].astype(np.float64),
        array[:, wanted.colors] if wanted.colors else None,
        array[:, wanted.normals] if wanted.normals else None,
    )


def _read_members(source: Source, archive: zipfile.ZipFile) -> PointCloud:
    members = archive.infolist()
    if len(members) > _MAX_MEMBERS:
        raise source.fault(f"the archive has {len(members)} members; save one with the points only")
    names = [info.filename.removesuffix(".npy") for info in members]
    expanded = 0

    def array(index: int) -> NDArray[Any]:
        nonlocal expanded
        expanded += members[index].file_size
        source.require_expansion(expanded, source.size)
        with archive.open(members[index]) as member:
            return read_array(Source(member, members[index].file_size, source.format))  # type: ignore[arg-type]

    at = _chosen(names, _POINT_KEYS)
    if at is None and len(names) == 1:
        at = 0
    if at is None:
        raise source.fault(
            f"the archive holds {', '.join(names)[:100]} but no array called "
            f"{' or '.join(_POINT_KEYS[:3])}; name the array of points so"
        )
    raw = _split(source, array(at))
    colors, normals = _chosen(names, _COLOR_KEYS), _chosen(names, _NORMAL_KEYS)
    raw = Raw(
        raw.points,
        raw.colors if colors is None else array(colors)[:, :3],
        raw.normals if normals is None else array(normals)[:, :3],
    )
    for extra in (raw.colors, raw.normals):
        if extra is not None and len(extra) != len(raw.points):
            raise source.fault(
                f"the archive holds {len(raw.points)} points but {len(extra)} colours or normals; "
                "save one for each point"
            )
    return assemble(raw, format=source.format)


def _chosen(names: Sequence[str], keys: Sequence[str]) -> int | None:
    return next((names.index(key) for key in keys if key in names), None)
