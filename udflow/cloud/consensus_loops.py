"""The plane that most of a neighbourhood shares, site by site: `consensus` as a compiled loop."""

from __future__ import annotations

import math

import numpy as np

from udflow.cloud.piece_loops import missed_by, weigh
from udflow.compiled import Array, compiled


@compiled
def consensus_rows(
    start: int, stop: int, samples: Array, origin: Array, frame: Array, coefficients: Array,
    radius: Array, tolerance: Array, distance: Array, index: Array,
    limits: tuple[int, int, int, int, float, float, float],
    agreed: Array, better: Array, piece: Array, error: Array,
) -> None:  # fmt: skip
    """Finds the planes of sites start..stop.

    Args:
        start, stop: rows.
        samples: (m, 3) the data.
        origin, frame, coefficients, radius: (n, ...) as in `LocalQuadrics`.
        tolerance: (n,) distance up to which a sample is on a plane.
        distance, index: (n, k or more) nearest samples, the first of them the site.
        limits: how many samples make planes, fewest and most samples of a piece; the sine of the
            angle at the site, the share of the neighbourhood, the breadth and the gain that are
            asked for.
        agreed: (n,) bool, whether there is a plane that enough samples share; filled in.
        better: (n,) bool, whether it explains more than the quadric there is; filled in.
        piece: (n, k) bool, the nearest samples on it; filled in.
        error: (n,) their root mean square distance from it; filled in.
    """
    corners, fewest, most, angle, share, broad, gain = limits
    pool = piece.shape[1]
    offset, weight = np.empty((pool, 3)), np.empty(pool)
    for i in range(start, stop):
        near, limit = index[i], float(tolerance[i])
        weigh(distance[i], pool, weight)
        for j in range(pool):
            for c in range(3):
                offset[j, c] = float(samples[near[j], c]) - float(origin[i, c])
        score, x, y, z = _best_plane(offset, distance[i], weight, limit, corners, angle)
        count, error[i], breadth = _members(offset, x, y, z, limit, most, piece[i])
        enough = score > share * weight.sum() and count >= fewest
        agreed[i] = enough and breadth > broad
        own = 0.0
        for j in range(pool):
            off = missed_by(i, samples, near[j], origin, frame, coefficients, radius) / limit
            own += max(0.0, 1 - off * off) * weight[j]
        better[i] = agreed[i] and score > gain * own


@compiled
def _best_plane(
    offset: Array, distance: Array, weight: Array, limit: float, corners: int, angle: float
) -> tuple[float, float, float, float]:
    """Of the planes through the site and two of the nearest samples that which explains most of
    (k, 3) offsets: how much, and its normal."""
    best = (0.0, 0.0, 0.0, 0.0)
    for i in range(1, min(corners, len(offset))):
        a, b, c = offset[i, 0], offset[i, 1], offset[i, 2]
        for j in range(i + 1, min(corners, len(offset))):
            d, e, f = offset[j, 0], offset[j, 1], offset[j, 2]
            x, y, z = b * f - c * e, c * d - a * f, a * e - b * d
            length = math.sqrt(x * x + y * y + z * z)
            if length <= angle * float(distance[i]) * float(distance[j]):
                continue
            x, y, z = x / length, y / length, z / length
            score = 0.0
            for k in range(len(offset)):
                off = (x * offset[k, 0] + y * offset[k, 1] + z * offset[k, 2]) / limit
                score += max(0.0, 1 - off * off) * weight[k]
            if score > best[0]:
                best = (score, x, y, z)
    return best


@compiled
def _members(
    offset: Array, x: float, y: float, z: float, limit: float, most: int, piece: Array
) -> tuple[int, float, float]:
    """Marks the nearest samples on a plane; how many they are, their root mean square distance
    from it, and how broad they lie: the product of their two main variances over the square of
    the sum, a quarter if all directions are alike, 0 on a line."""
    count = 0
    squares = xx = xy = xz = yy = yz = zz = 0.0
    for k in range(len(offset)):
        a, b, c = offset[k, 0], offset[k, 1], offset[k, 2]
        off = x * a + y * b + z * c
        piece[k] = count < most and abs(off) < limit
        if not piece[k]:
            continue
        count += 1
        squares += off * off
        xx, xy, xz = xx + a * a, xy + a * b, xz + a * c
        yy, yz, zz = yy + b * b, yz + b * c, zz + c * c
    total = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    return count, math.sqrt(squares / max(count, 1)), minors / max(total * total, 1e-300)
