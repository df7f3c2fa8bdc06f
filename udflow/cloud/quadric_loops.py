"""Feet on blended quadrics, query by query: `quadric_surface` and `creases` as a compiled loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from udflow.cloud.creases import (
    BEHIND,
    DISSENT,
    LOCAL,
    NEAR,
    OFF,
    ON_DATA,
    PARALLEL,
    ROUNDS,
    SAME_PIECE,
    TURNED,
    WAY,
)
from udflow.cloud.quadrics import NEWTON_STEPS, PATCH
from udflow.compiled import compiled

Array = Any  # a NumPy array inside a compiled loop
Vector = tuple[float, float, float]
# why a pair of plain functions and tuples: arrays made inside the loop would cost more than it


@compiled
def project_rows(
    start: int, stop: int, points: Array, index: Array, distance: Array,
    origin: Array, frame: Array, coefficients: Array, radius: Array, spacing: Array,
    reach: float, result: Array,
) -> None:  # fmt: skip
    """Feet of queries start..stop.

    Args:
        start, stop: rows.
        points: (n, 3) queries.
        index: (n, c) the nearest quadrics, nearest site first.
        distance: (n, c) of their sites.
        origin, frame, coefficients, radius, spacing: of all quadrics, as in `LocalQuadrics`.
        reach: spacings from the nearest site beyond which there is no foot.
        result: (n, 3), filled in.
    """
    count = index.shape[1]
    feet, share = np.empty((count, 3)), np.empty(count)
    of_foot, of_site = np.empty((count, count)), np.empty((count, count))
    turned, beyond = np.empty((count, count), np.bool_), np.empty((count, count), np.bool_)
    for row in range(start, stop):
        near = index[row]
        point = (float(points[row, 0]), float(points[row, 1]), float(points[row, 2]))
        for j in range(count):
            foot = _foot(near[j], point, origin, frame, coefficients, radius)
            feet[j, 0], feet[j, 1], feet[j, 2] = foot
        length = float(spacing[near[0]])
        first, last = float(distance[row, 0]) ** 2, float(distance[row, count - 1]) ** 2
        for j in range(count):
            far = (float(distance[row, j]) ** 2 - first) / max(last, 1e-18)
            share[j] = math.exp(-4 * far)
        if _creased(near, distance[row, 0], length, frame):
            _compare(near, feet, length, origin, frame, coefficients, radius,
                     of_foot, of_site, turned, beyond)  # fmt: skip
            foot = _at_crease(near, point, feet, share, length, origin, frame, coefficients,
                              radius, of_foot, turned, beyond)  # fmt: skip
        else:
            foot = _blended(feet, _row(feet, 0), share, length)
        site = _row(origin, near[0])
        offset = _minus(foot, site)
        shrink = min(1.0, reach * length / max(_norm(offset), 1e-18))
        for i in range(3):
            result[row, i] = site[i] + shrink * offset[i]


@compiled
def _row(array: Array, i: int) -> Vector:
    return float(array[i, 0]), float(array[i, 1]), float(array[i, 2])


@compiled
def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _norm(a: Vector) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def _local(q: int, point: Vector, origin: Array, frame: Array, radius: Array) -> Vector:
    """The point in the frame of a quadric, in its radii."""
    offset = _minus(point, _row(origin, q))
    scale = 1.0 / float(radius[q])
    axes = frame[q]
    return (
        scale * _dot(offset, _row(axes, 0)),
        scale * _dot(offset, _row(axes, 1)),
        scale * _dot(offset, _row(axes, 2)),
    )


@compiled
def _world(q: int, local: Vector, origin: Array, frame: Array, radius: Array) -> Vector:
    scale, axes = float(radius[q]), frame[q]
    u, v, w = scale * local[0], scale * local[1], scale * local[2]
    return (
        origin[q, 0] + u * axes[0, 0] + v * axes[1, 0] + w * axes[2, 0],
        origin[q, 1] + u * axes[0, 1] + v * axes[1, 1] + w * axes[2, 1],
        origin[q, 2] + u * axes[0, 2] + v * axes[1, 2] + w * axes[2, 2],
    )


@compiled
def _height(c: Array, u: float, v: float) -> float:
    """Of the quadric with coefficients (6,) over u and v."""
    return float(c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v)


@compiled
def _over(q: int, local: Vector, coefficients: Array, radius: Array) -> float:
    """Height of a point in the frame of a quadric over it, along its own w."""
    return (local[2] - _height(coefficients[q], local[0], local[1])) * float(radius[q])


@compiled
def _normal(q: int, local: Vector, frame: Array, coefficients: Array) -> Vector:
    """Unit normal of a quadric above or below a point in its frame."""
    u, v, _ = local
    c, axes = coefficients[q], frame[q]
    a = -float(c[1] + 2 * c[3] * u + c[4] * v)
    b = -float(c[2] + c[4] * u + 2 * c[5] * v)
    shrink = 1.0 / math.sqrt(a * a + b * b + 1.0)
    return (
        shrink * (a * axes[0, 0] + b * axes[1, 0] + axes[2, 0]),
        shrink * (a * axes[0, 1] + b * axes[1, 1] + axes[2, 1]),
        shrink * (a * axes[0, 2] + b * axes[1, 2] + axes[2, 2]),
    )


@compiled
def _foot(q: int, point: Vector, origin: Array, frame: Array, coefficients: Array,
          radius: Array) -> Vector:  # fmt: skip
    """The nearest point on a quadric, as `feet_on_quadrics`."""
    local = _local(q, point, origin, frame, radius)
    c = coefficients[q]
    u, v, w = local
    for _ in range(NEWTON_STEPS):
        slope_u = c[1] + 2 * c[3] * u + c[4] * v
        slope_v = c[2] + c[4] * u + 2 * c[5] * v
        above = w - _height(c, u, v)
        gradient_u = (u - local[0]) - above * slope_u
        gradient_v = (v - local[1]) - above * slope_v
        uu, uv, vv = 1 + slope_u * slope_u, slope_u * slope_v, 1 + slope_v * slope_v
        full_uu, full_uv = uu - 2 * above * c[3], uv - above * c[4]
        full_vv = vv - 2 * above * c[5]
        if full_uu > 0.2 and full_uu * full_vv - full_uv * full_uv > 0.2:
            uu, uv, vv = full_uu, full_uv, full_vv
        scale = 1.0 / (uu * vv - uv * uv)
        u -= scale * (vv * gradient_u - uv * gradient_v)
        v -= scale * (uu * gradient_v - uv * gradient_u)
        u, v = min(max(u, -PATCH), PATCH), min(max(v, -PATCH), PATCH)
    best = (u, v, _height(c, u, v))
    least = _norm(_minus(best, local))
    for share in (0.5, 0.0):
        nearer = (share * u, share * v, _height(c, share * u, share * v))
        length = _norm(_minus(nearer, local))
        if length < least:
            best, least = nearer, length
    return _world(q, best, origin, frame, radius)


@compiled
def _blended(feet: Array, lead: Vector, share: Array, spacing: float) -> Vector:
    """As `Candidates.blended`; share (c,) is the weight by the closeness of the sites."""
    x = y = z = total = 0.0
    for j in range(len(share)):
        dissent = _norm(_minus(_row(feet, j), lead)) / (DISSENT * spacing)
        weight = share[j] * math.exp(-dissent * dissent)
        x, y, z = x + weight * feet[j, 0], y + weight * feet[j, 1], z + weight * feet[j, 2]
        total += weight
    total = max(total, 1e-12)
    return x / total, y / total, z / total


@compiled
def _creased(near: Array, distance: float, spacing: float, frame: Array) -> bool:
    """As `Candidates.creased`."""
    if distance >= NEAR * spacing:
        return False
    first = _row(frame[near[0]], 2)
    for j in range(1, len(near)):
        if abs(_dot(first, _row(frame[near[j]], 2))) < TURNED:
            return True
    return False


@compiled
def _compare(
    near: Array, feet: Array, spacing: float, origin: Array, frame: Array, coefficients: Array,
    radius: Array, of_foot: Array, of_site: Array, turned: Array, beyond: Array,
) -> None:  # fmt: skip
    """Fills in (c, c) for quadrics k and j: the height of j's site over k, whether the two are
    different pieces, and for those the height of j's foot and whether it lies beyond k. See
    `creases`."""
    count = len(near)
    for k in range(count):
        for j in range(count):
            site = _local(near[k], _row(origin, near[j]), origin, frame, radius)
            of_site[k, j] = _over(near[k], site, coefficients, radius)
            led_to = _normal(near[k], site, frame, coefficients)
            turned[k, j] = abs(_dot(led_to, _row(frame[near[j]], 2))) < TURNED
    for k in range(count):
        for j in range(k):
            turned[k, j] = turned[j, k] = turned[k, j] and turned[j, k]
    for k in range(count):
        for j in range(count):
            beyond[k, j] = False
            if turned[k, j]:
                foot = _local(near[k], _row(feet, j), origin, frame, radius)
                of_foot[k, j] = _over(near[k], foot, coefficients, radius)
                beyond[k, j] = _ends(k, j, near, feet, spacing, origin, of_foot, of_site, turned)


@compiled
def _ends(
    k: int, j: int, near: Array, feet: Array, spacing: float, origin: Array, of_foot: Array,
    of_site: Array, turned: Array,
) -> bool:  # fmt: skip
    """Whether quadric k ends piece j before its foot."""
    apart = _norm(_minus(_row(feet, j), _row(origin, near[k])))
    if abs(of_foot[k, j]) <= OFF * spacing or apart >= LOCAL * spacing:
        return False
    total, ahead, behind = 0.0, False, False
    for i in range(len(near)):
        if turned[j, i] or abs(of_site[j, i]) >= SAME_PIECE * spacing:
            continue
        height = of_site[k, i]
        total += height
        ahead = ahead or height > 2 * OFF * spacing
        behind = behind or height < -2 * OFF * spacing
    side = of_site[k, j] if abs(of_site[k, j]) > OFF * spacing else total
    if abs(side) <= OFF * spacing or of_foot[k, j] * side >= 0:
        return False
    return not (ahead if of_foot[k, j] > 0 else behind)


@compiled
def _at_crease(
    near: Array, point: Vector, feet: Array, share: Array, spacing: float, origin: Array,
    frame: Array, coefficients: Array, radius: Array, of_foot: Array, turned: Array,
    beyond: Array,
) -> Vector:  # fmt: skip
    """As `feet_at_creases`."""
    count = len(near)
    least = np.inf
    for j in range(count):
        least = min(least, _norm(_minus(_row(feet, j), point)))
    lead, shortest = -1, np.inf
    valid = np.zeros(count, np.bool_)
    for j in range(count):
        length = _norm(_minus(_row(feet, j), point))
        reached = length < least + BEHIND * spacing and not beyond[:, j].any()
        valid[j] = reached and _on_data(_row(feet, j), near, origin, spacing)
        if valid[j] and length < shortest:
            lead, shortest = j, length
    if lead < 0:
        return _where_two_meet(near, point, feet, share, spacing, origin, frame, coefficients,
                               radius, of_foot, beyond)  # fmt: skip
    allowed = np.zeros(count)
    for j in range(count):
        if valid[j] and not turned[lead, j]:
            allowed[j] = share[j]
    return _blended(feet, _row(feet, lead), allowed, spacing)


@compiled
def _where_two_meet(
    near: Array, point: Vector, feet: Array, share: Array, spacing: float, origin: Array,
    frame: Array, coefficients: Array, radius: Array, of_foot: Array, beyond: Array,
) -> Vector:  # fmt: skip
    """As `creases._where_two_meet`."""
    crossed, highest = 0, -1.0
    for k in range(len(near)):
        if beyond[k, 0] and abs(of_foot[k, 0]) > highest:
            crossed, highest = k, abs(of_foot[k, 0])
    one, two = near[0], near[crossed]
    foot = _row(feet, 0)
    for _ in range(ROUNDS):
        on_one = _foot(one, foot, origin, frame, coefficients, radius)
        on_two = _foot(two, foot, origin, frame, coefficients, radius)
        a = _normal(one, _local(one, on_one, origin, frame, radius), frame, coefficients)
        b = _normal(two, _local(two, on_two, origin, frame, radius), frame, coefficients)
        foot = _on_planes(point, on_one, a, on_two, b)
    lone = _blended(feet, _row(feet, 0), share, spacing)
    if _norm(_minus(foot, lone)) > WAY * spacing:
        foot = lone
    if _on_data(foot, near, origin, spacing):
        return foot
    return _nearest_on_data(near, point, feet, spacing, origin)


@compiled
def _on_data(foot: Vector, near: Array, origin: Array, spacing: float) -> bool:
    """As `Candidates.on_data`."""
    for j in range(len(near)):
        if _norm(_minus(foot, _row(origin, near[j]))) < ON_DATA * spacing:
            return True
    return False


@compiled
def _nearest_on_data(
    near: Array, point: Vector, feet: Array, spacing: float, origin: Array
) -> Vector:
    """As `Candidates.nearest_on_data`."""
    best, least = _row(origin, near[0]), np.inf
    for j in range(len(near)):
        foot = _row(feet, j)
        way = _norm(_minus(foot, point))
        if way < least and _on_data(foot, near, origin, spacing):
            best, least = foot, way
    return best


@compiled
def _on_planes(point: Vector, on_a: Vector, a: Vector, on_b: Vector, b: Vector) -> Vector:
    """The nearest point on the line where planes with normals a and b meet."""
    cosine = _dot(a, b)
    over_a, over_b = _dot(_minus(point, on_a), a), _dot(_minus(point, on_b), b)
    scale = max(1 - cosine * cosine, PARALLEL)
    along_a, along_b = (over_a - cosine * over_b) / scale, (over_b - cosine * over_a) / scale
    return (
        point[0] - along_a * a[0] - along_b * b[0],
        point[1] - along_a * a[1] - along_b * b[1],
        point[2] - along_a * a[2] - along_b * b[2],
    )
