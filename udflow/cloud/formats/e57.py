"""E57 (ASTM E2807): terrestrial laser scans, several in a file, each with its pose.

Read are coordinates, Cartesian or spherical, colours, and which points are valid; pictures are
left where they are. The layout is that of libE57Format, the reference implementation.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.assemble import assemble
from udflow.cloud.formats.columns import Raw
from udflow.cloud.formats.e57_pages import PAGE, Pages
from udflow.cloud.formats.e57_streams import read_streams, values_of
from udflow.cloud.formats.e57_xml import XML_LIMIT, Column, ScanPart, read_parts
from udflow.cloud.formats.source import Source
from udflow.cloud.point_cloud import PointCloud

_HEADER = struct.Struct("<8sIIQQQQ")
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_INVALID = {_CARTESIAN: "cartesianInvalidState", _SPHERICAL: "sphericalInvalidState"}


def read_e57(source: Source) -> PointCloud:
    """The points of all scans of an E57 file in the frame of the file, in double precision.

    Points that the scanner marked as invalid are dropped and counted. Colours are kept where all
    scans have them.

    Raises:
        InvalidCloud: a damaged page, counts that the file cannot hold, or no coordinates.
    """
    pages = Pages(source)
    parts = [part for part in read_parts(source, _xml(source, pages)) if part.points]
    total = sum(part.points for part in parts)
    source.require_count(total)
    source.require_expansion(24 * total, source.size)
    found = []
    unread = pages.size  # no two scans share bytes: what is read in all is bounded
    for part in parts:
        streams, length = read_streams(source, pages, part, _wanted(source, part), unread)
        unread -= length
        found.append(_raw(source, part, streams))
    points = np.concatenate([raw.points for raw in found])
    colors = [raw.colors for raw in found if raw.colors is not None]
    whole = len(colors) == len(found)
    said = () if whole or not colors else ("the colours were ignored: not all scans have them",)
    kept = np.concatenate(colors) if whole and np.any(colors[0]) else None
    return assemble(Raw(points, kept), format=source.format, warnings=said)


def _xml(source: Source, pages: Pages) -> bytes:
    head = pages.read(0, _HEADER.size, "the header")
    _, major, _, length, physical, size, page = _HEADER.unpack(head)
    if major != 1 or page != PAGE:
        raise source.fault(f"version {major} with pages of {page} bytes is not read")
    if length > source.size:
        raise source.fault(
            f"the file has {source.size} bytes of {length}; it is truncated. Export or upload "
            "it again"
        )
    if size > XML_LIMIT:
        raise source.fault(f"the XML section claims {size} bytes; the file is damaged")
    return pages.read(pages.logical(physical, "the XML section"), size, "the XML section")


def _wanted(source: Source, part: ScanPart) -> list[int]:
    """The numbers of the streams that are needed.

    Raises:
        InvalidCloud: the scan has no coordinates that are understood.
    """
    names = _coordinates(source, part)
    wanted = {*names, _INVALID[names], *_COLORS}
    return [number for number, column in enumerate(part.columns) if column.name in wanted]


def _coordinates(source: Source, part: ScanPart) -> tuple[str, str, str]:
    there = {column.name for column in part.columns if column.kind != "other"}
    for names in (_CARTESIAN, _SPHERICAL):
        if there.issuperset(names):
            return names
    raise source.fault("a scan has neither Cartesian nor spherical coordinates")


def _raw(source: Source, part: ScanPart, streams: dict[int, bytes]) -> Raw:
    columns = {part.columns[number].name: number for number in streams}

    def values(name: str) -> NDArray[Any]:
        number = columns[name]
        return values_of(source, part.columns[number], streams[number], part.points)

    names = _coordinates(source, part)
    points = np.stack([values(name) for name in names], axis=1).astype(np.float64)
    if names == _SPHERICAL:
        points = _from_spherical(points)
    if _INVALID[names] in columns:
        points[values(_INVALID[names]) != 0] = np.nan
    points = points @ part.rotation.T + part.translation
    if not columns.keys() >= set(_COLORS):
        return Raw(points)
    there = [part.columns[columns[name]] for name in _COLORS]
    colors = np.stack([values(name) for name in _COLORS], axis=1)
    return Raw(points, _scaled(colors, part.color_range or _declared(there)))


def _from_spherical(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Range, azimuth and elevation (radians) as coordinates."""
    distance, azimuth, elevation = values.T
    level = distance * np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1
    )


def _declared(columns: Sequence[Column]) -> tuple[float, float] | None:
    """The range that the columns' own limits allow; None if that says nothing."""
    low = min(column.minimum * column.scale + column.offset for column in columns)
    high = max(column.maximum * column.scale + column.offset for column in columns)
    return (low, high) if all(0 < column.bits <= 16 for column in columns) else None


def _scaled(colors: NDArray[Any], limits: tuple[float, float] | None) -> NDArray[Any]:
    """Colours from 0 to 1, or as they are where their range is not known."""
    if limits is None:
        return colors
    low, high = limits
    unit: NDArray[np.float32] = np.clip((colors - low) / (high - low), 0.0, 1.0).astype(np.float32)
    return unit
