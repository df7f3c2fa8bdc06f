"""What all readers share at the end: finite points, plausible magnitudes, uniform colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.formats.columns import Raw
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

_TINY, _HUGE = 1e-30, 1e30
# Coordinates of one scan span a few decades, rounding residue of a tilted plane at most 17.
# The bytes of a float read in the wrong order give exponents spread over all 76.
_DECADES = 30.0
_PLAUSIBILITY_SAMPLE = 100_000


def assemble(raw: Raw, *, format: str, warnings: tuple[str, ...] = ()) -> PointCloud:
    """A PointCloud from what a reader found.

    Points that are not finite are dropped and counted. Colours may be whole numbers on a scale of
    255 or 65535, or floats on a scale of 1, 255 or 65535.

    Raises:
        InvalidCloud: no point is left, or the magnitudes are those of a wrong byte order.
    """
    label = format.upper()
    points, colors, normals = raw.points, raw.colors, raw.normals
    if len(points) == 0:
        raise InvalidCloud(f"{label}: the file holds no points; choose one that does")
    require_plausible(points, label)
    said = list(warnings)
    finite = np.isfinite(points).all(axis=1)
    dropped = int(len(points) - np.count_nonzero(finite))
    if dropped == len(points):
        raise InvalidCloud(
            f"{label}: none of the {dropped} points has finite coordinates; export the scan again"
        )
    if dropped:
        said.append(f"{dropped} points with undefined or infinite coordinates were left out")
        points = points[finite]
        colors = None if colors is None else colors[finite]
        normals = None if normals is None else normals[finite]
    return PointCloud(
        points=np.ascontiguousarray(points, dtype=np.float64),
        colors=None if colors is None else _to_srgb8(colors, said),
        normals=None if normals is None else _to_normals(normals),
        format=format,
        dropped=dropped,
        warnings=tuple(said),
    )


def require_plausible(points: NDArray[np.float64], label: str) -> None:
    """Refuse (n, 3) coordinates that only a wrong byte order or damage explains.

    Raises:
        InvalidCloud: most magnitudes are below 1e-30 or above 1e30, or they are spread over
            more than 30 decades.
    """
    sample = points[:: max(1, len(points) // _PLAUSIBILITY_SAMPLE)]
    size = np.abs(sample[np.isfinite(sample) & (sample != 0.0)])
    if len(size) == 0:
        return
    absurd = np.count_nonzero((size < _TINY) | (size > _HUGE))
    low, high = np.quantile(np.log10(size), (0.1, 0.9))
    if 2 * absurd > len(size) or high - low > _DECADES:
        raise InvalidCloud(
            f"{label}: the coordinates run from {size.min():.1e} to {size.max():.1e}. Wrong byte "
            "order? Check that the header names the byte order in which the numbers were written"
        )


def _to_srgb8(colors: NDArray[Any], said: list[str]) -> NDArray[np.uint8] | None:
    """Colours (n, 3) on any usual scale as uint8; None, and a sentence, where there are none."""
    top, bottom = float(np.max(colors)), float(np.min(colors))
    if not (np.isfinite(top) and bottom >= 0.0 and top <= 65535.0):
        said.append("the colours were ignored: values outside 0..1, 0..255 and 0..65535")
        return None
    if top == 0.0:
        said.append("the colours were ignored: all are black")
        return None
    if colors.dtype == np.uint8:
        return np.ascontiguousarray(colors)
    if colors.dtype.kind == "f" and top <= 1.0:
        scale = 255.0
    else:
        scale = 1.0 if top <= 255.0 else 255.0 / 65535.0
    scaled: NDArray[np.float32] = colors.astype(np.float32) * np.float32(scale)
    return np.rint(scaled).astype(np.uint8)


def _to_normals(normals: NDArray[Any]) -> NDArray[np.float32] | None:
    """Normals (n, 3) as float32, undefined ones zero; None where all are zero."""
    with np.errstate(over="ignore"):
        single = normals.astype(np.float32)
    single[~np.isfinite(single).all(axis=1)] = 0.0
    return single if single.any() else None
