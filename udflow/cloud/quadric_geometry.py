"""Vectors, and one quadric at a time: what compiled loops over quadrics are made of."""

from __future__ import annotations

import math

from udflow.cloud.creases import PARALLEL
from udflow.cloud.quadrics import NEWTON_STEPS, PATCH
from udflow.compiled import Array, compiled

Vector = tuple[float, float, float]
# why a pair of plain functions and tuples: arrays made inside the loop would cost more than it


@compiled
def row_of(array: Array, i: int) -> Vector:
    return float(array[i, 0]), float(array[i, 1]), float(array[i, 2])


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def norm(a: Vector) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def in_frame(q: int, point: Vector, origin: Array, frame: Array, radius: Array) -> Vector:
    """The point in the frame of a quadric, in its radii."""
    offset = minus(point, row_of(origin, q))
    scale = 1.0 / float(radius[q])
    axes = frame[q]
    return (
        scale * dot(offset, row_of(axes, 0)),
        scale * dot(offset, row_of(axes, 1)),
        scale * dot(offset, row_of(axes, 2)),
    )


@compiled
def in_space(q: int, local: Vector, origin: Array, frame: Array, radius: Array) -> Vector:
    scale, axes = float(radius[q]), frame[q]
    u, v, w = scale * local[0], scale * local[1], scale * local[2]
    return (
        origin[q, 0] + u * axes[0, 0] + v * axes[1, 0] + w * axes[2, 0],
        origin[q, 1] + u * axes[0, 1] + v * axes[1, 1] + w * axes[2, 1],
        origin[q, 2] + u * axes[0, 2] + v * axes[1, 2] + w * axes[2, 2],
    )


@compiled
def height_of(c: Array, u: float, v: float) -> float:
    """Of the quadric with coefficients (6,) over u and v."""
    return float(c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v)


@compiled
def height_over(q: int, local: Vector, coefficients: Array, radius: Array) -> float:
    """Height of a point in the frame of a quadric over it, along its own w."""
    return (local[2] - height_of(coefficients[q], local[0], local[1])) * float(radius[q])


@compiled
def normal_at(q: int, local: Vector, frame: Array, coefficients: Array) -> Vector:
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
def foot_on(q: int, point: Vector, origin: Array, frame: Array, coefficients: Array,
          radius: Array) -> Vector:  # fmt: skip
    """The nearest point on a quadric, as `feet_on_quadrics`."""
    local = in_frame(q, point, origin, frame, radius)
    c = coefficients[q]
    u, v, w = local
    for _ in range(NEWTON_STEPS):
        slope_u = c[1] + 2 * c[3] * u + c[4] * v
        slope_v = c[2] + c[4] * u + 2 * c[5] * v
        above = w - height_of(c, u, v)
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
    best = (u, v, height_of(c, u, v))
    least = norm(minus(best, local))
    for share in (0.5, 0.0):
        nearer = (share * u, share * v, height_of(c, share * u, share * v))
        length = norm(minus(nearer, local))
        if length < least:
            best, least = nearer, length
    return in_space(q, best, origin, frame, radius)


@compiled
def on_planes(point: Vector, on_a: Vector, a: Vector, on_b: Vector, b: Vector) -> Vector:
    """The nearest point on the line where planes with normals a and b meet."""
    cosine = dot(a, b)
    over_a, over_b = dot(minus(point, on_a), a), dot(minus(point, on_b), b)
    scale = max(1 - cosine * cosine, PARALLEL)
    along_a, along_b = (over_a - cosine * over_b) / scale, (over_b - cosine * over_a) / scale
    return (
        point[0] - along_a * a[0] - along_b * b[0],
        point[1] - along_a * a[1] - along_b * b[1],
        point[2] - along_a * a[2] - along_b * b[2],
    )
