"""Feet on blended quadrics, query by query: `quadric_surface` as a compiled loop."""

from __future__ import annotations

import math

import numpy as np

from udflow.cloud.crease_loops import blended, compare, foot_at_crease, is_creased
from udflow.cloud.creases import NEARER
from udflow.cloud.quadric_geometry import Vector, dot, foot_on, minus, norm, row_of
from udflow.compiled import Array, compiled


@compiled
def project_rows(
    start: int, stop: int, points: Array, index: Array, distance: Array,
    origin: Array, frame: Array, coefficients: Array, radius: Array, spacing: Array,
    limits: tuple[float, float, float], result: Array,
) -> None:  # fmt: skip
    """Feet of queries start..stop.

    Args:
        start, stop: rows.
        points: (n, 3) queries.
        index: (n, c) the nearest quadrics, nearest site first.
        distance: (n, c) of their sites.
        origin, frame, coefficients, radius, spacing: of all quadrics, as in `LocalQuadrics`.
        limits: spacings from the nearest site beyond which there is no foot, for queries near it
            and for those far away; and spacings up to which they are near.
        result: (n, 3), filled in.
    """
    near_reach, far_reach, until = limits
    count = index.shape[1]
    feet, share = np.empty((count, 3)), np.empty(count)
    of_foot, of_site = np.empty((count, count)), np.empty((count, count))
    turned, beyond = np.empty((count, count), np.bool_), np.empty((count, count), np.bool_)
    for row in range(start, stop):
        near = index[row]
        point = (float(points[row, 0]), float(points[row, 1]), float(points[row, 2]))
        for j in range(count):
            foot = foot_on(near[j], point, origin, frame, coefficients, radius)
            feet[j, 0], feet[j, 1], feet[j, 2] = foot
        length = float(spacing[near[0]])
        first, last = float(distance[row, 0]) ** 2, float(distance[row, count - 1]) ** 2
        for j in range(count):
            far = (float(distance[row, j]) ** 2 - first) / max(last, 1e-18)
            share[j] = math.exp(-4 * far)
        site = row_of(origin, near[0])
        if is_creased(near, distance[row, 0], length, frame):
            compare(near, feet, length, origin, frame, coefficients, radius,
                    of_foot, of_site, turned, beyond)  # fmt: skip
            foot = foot_at_crease(near, point, feet, share, length, origin, frame, coefficients,
                                  radius, of_foot, turned, beyond)  # fmt: skip
        else:
            lead = _leading(near, point, feet, near_reach * length, NEARER * length, origin)
            site = row_of(origin, near[lead])
            foot = blended(feet, row_of(feet, lead), share, length)
        offset = minus(foot, site)
        reach = near_reach
        if (
            distance[row, 0] > until * length
            and _overshoot(foot, near, origin) > far_reach * length
        ):
            nearness = until * length / float(distance[row, 0])
            reach = far_reach + (near_reach - far_reach) * nearness * nearness
        shrink = min(1.0, reach * length / max(norm(offset), 1e-18))
        for i in range(3):
            result[row, i] = site[i] + shrink * offset[i]


@compiled
def _leading(
    near: Array, point: Vector, feet: Array, reach: float, nearer: float, origin: Array
) -> int:
    """As `Candidates.leading`."""
    lead, least = 0, norm(minus(row_of(feet, 0), point)) - nearer
    for j in range(1, len(near)):
        way = norm(minus(row_of(feet, j), point))
        if way < least and norm(minus(row_of(feet, j), row_of(origin, near[j]))) < reach:
            lead, least = j, way
    return lead


@compiled
def _overshoot(foot: Vector, near: Array, origin: Array) -> float:
    """As `quadric_surface._overshoot`."""
    x = y = z = 0.0
    for j in range(len(near)):
        offset = minus(row_of(origin, near[j]), foot)
        x, y, z = x + offset[0], y + offset[1], z + offset[2]
    inwards, least = (x, y, z), np.inf
    length = max(norm(inwards), 1e-18)
    for j in range(len(near)):
        least = min(least, dot(minus(row_of(origin, near[j]), foot), inwards) / length)
    return least
