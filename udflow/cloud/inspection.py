"""What a scan is made of, said before anything is computed from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.cloud.distinct import distinct
from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.shift import suggested_shift
from udflow.errors import InvalidCloud

MIN_UNIQUE_POINTS = 100
_NARROWEST = 1e-6  # extents that points are off one line, at least, to be more than a line
_LARGEST, _SMALLEST_EXTENT = 1e30, 1e-30
_SPACING_SAMPLE = 20_000
_NOISE_SAMPLE = 4_000
_NOISE_NEIGHBOURS = 16
_DUPLICATES_WORTH_SAYING = 0.01
_UNEVEN = 20.0
_FLAT = 1e-9

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class CloudSummary:
    """A scan in numbers; lengths are in the units of the scan.

    Attributes:
        format: of the file.
        points: finite points read; dropped: points left out as not finite.
        unique_points: points that differ in at least one coordinate.
        low, high, extent: bounding box and its sides.
        spacing: median distance from a unique point to its nearest neighbour.
        noise: standard deviation of points about the plane through their 16 nearest neighbours,
            the median over the scan. Curvature within 16 neighbours counts as noise, so on clean
            scans this is an upper bound.
        shift: to subtract before single precision is used, or None where coordinates are small.
        warnings: sentences for the user.
    """

    format: str
    points: int
    dropped: int
    unique_points: int
    low: Vector
    high: Vector
    extent: Vector
    spacing: float
    noise: float
    has_colors: bool
    has_normals: bool
    shift: Vector | None
    warnings: tuple[str, ...]


def inspect(cloud: PointCloud) -> CloudSummary:
    """Count, measure and judge a cloud that `require_reconstructable` accepts.

    Spacing and noise are medians over samples of the points, so this is fast on large scans.
    """
    unique = cloud.points[distinct(cloud.points)]
    low, high = unique.min(axis=0), unique.max(axis=0)
    tree = cKDTree(unique, balanced_tree=False, compact_nodes=False)
    nearest = _nearest_distances(tree)
    noise = _noise(tree)
    shift = suggested_shift(low, high)
    remarks = _remarks(len(cloud.points), len(unique), nearest, shift)
    if noise <= _FLAT * float((high - low).max()):
        remarks.append(
            "most neighbourhoods are exactly flat: the noise cannot be told (a drawn model, or a "
            "sensor whose depth comes in steps)"
        )
    return CloudSummary(
        format=cloud.format,
        points=len(cloud.points),
        dropped=cloud.dropped,
        unique_points=len(unique),
        low=_vector(low),
        high=_vector(high),
        extent=_vector(high - low),
        spacing=float(np.median(nearest)),
        noise=noise,
        has_colors=cloud.colors is not None,
        has_normals=cloud.normals is not None,
        shift=shift,
        warnings=(*cloud.warnings, *remarks),
    )


def require_reconstructable(cloud: PointCloud) -> None:
    """Refuse clouds that no surface can be made of.

    Raises:
        InvalidCloud: coordinates that are not finite or beyond 1e30, all points equal, an extent
            below 1e-30, fewer than 100 distinct points, or all of them on one straight line.
    """
    points = cloud.points
    if len(points) == 0:
        raise InvalidCloud("the cloud holds no points; choose a scan that does")
    low, high = points.min(axis=0), points.max(axis=0)
    largest = max(float(np.abs(low).max()), float(np.abs(high).max()))
    if not largest <= _LARGEST:
        raise InvalidCloud(
            f"the largest coordinate is {largest:.1e}. Wrong byte order? "
            "Remove the wrong points or export the scan again"
        )
    extent = float((high - low).max())
    if extent == 0.0:
        raise InvalidCloud("all points are equal: the cloud has no extent. Check the export")
    if extent < _SMALLEST_EXTENT:
        raise InvalidCloud(
            f"the extent is {extent:.1e}, too small to compute with. Wrong byte order? "
            "Scale the scan up or export it again"
        )
    count = len(distinct(points))
    if count < MIN_UNIQUE_POINTS:
        raise InvalidCloud(
            f"the cloud has {count} distinct points; a surface needs at least "
            f"{MIN_UNIQUE_POINTS}. Scan more densely"
        )
    if _breadth((points - low) / extent) < _NARROWEST:
        raise InvalidCloud(
            "all points lie on one straight line, which has no surface. Are the right columns "
            "read as x, y and z?"
        )


def _breadth(points: NDArray[np.float64]) -> float:
    """Root mean square distance of points (n, 3) from the line through them that is nearest."""
    offset = points - points.mean(axis=0)
    spread = np.linalg.eigvalsh(offset.T @ offset / len(points))
    return float(np.sqrt(max(spread[0] + spread[1], 0.0)))


def _nearest_distances(tree: cKDTree) -> NDArray[np.float64]:
    """Distance to the nearest other point, for a sample of the points; zero for a lone point."""
    if tree.n < 2:
        return np.zeros(1)
    distances, _ = tree.query(_every(tree.data, _SPACING_SAMPLE), k=2)
    return np.asarray(distances)[:, 1]


def _noise(tree: cKDTree) -> float:
    """See CloudSummary.noise."""
    neighbours = min(_NOISE_NEIGHBOURS, tree.n)
    if neighbours < 4:  # a plane goes through three points exactly
        return 0.0
    _, index = tree.query(_every(tree.data, _NOISE_SAMPLE), k=neighbours)
    near = np.asarray(tree.data)[index]
    scale = float(np.ptp(near, axis=(0, 1)).max()) or 1.0
    # Scaled before squaring, so that no extent overflows or vanishes.
    near = (near - near.mean(axis=1, keepdims=True)) / scale
    spread = np.einsum("nki,nkj->nij", near, near)
    across = np.maximum(np.linalg.eigvalsh(spread)[:, 0], 0.0)
    return scale * float(np.median(np.sqrt(across / (neighbours - 3))))


def _every(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """At most about `count` points, evenly through the list."""
    return np.asarray(points)[:: max(1, len(points) // count)]


def _remarks(
    points: int, unique: int, nearest: NDArray[np.float64], shift: Vector | None
) -> list[str]:
    """Sentences on what a user may not expect."""
    said = []
    share = 1.0 - unique / points
    if share > _DUPLICATES_WORTH_SAYING:
        said.append(f"{share:.0%} of the points are exact duplicates; each place counts once")
    near, far = np.quantile(nearest, (0.05, 0.95))
    if near > 0.0 and far > _UNEVEN * near:
        said.append(
            f"the density is very uneven: neighbours lie {near:.3g} apart where it is densest "
            f"and {far:.3g} where it is sparsest"
        )
    if shift is not None:
        said.append("the coordinates are large; results are computed around a shifted origin")
    return said


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
