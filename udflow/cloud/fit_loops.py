"""Fits of local quadrics and means over their neighbours, site by site, as compiled loops."""

from __future__ import annotations

import math

import numpy as np

from udflow.cloud.quadric_geometry import foot_on
from udflow.cloud.quadrics import FALLOFF, RIDGE
from udflow.compiled import Array, compiled

Room = tuple[Array, Array, Array, Array, Array, Array]  # arrays to compute in, one set a thread
_SWEEPS = 10  # of Jacobi's rotations; four or five do
_SMALL = 1e-28  # share of the squared trace below which what is off the diagonal is nothing


@compiled
def fit_rows(
    start: int, stop: int, samples: Array, origin: Array, rows: Array, distance: Array,
    index: Array, k: int, frame: Array, coefficients: Array, radius: Array, error: Array,
    variance: Array, foot: Array,
) -> None:  # fmt: skip
    """Fits quadrics start..stop to the k nearest samples.

    Args:
        start, stop: rows of the results.
        samples: (m, 3) the data.
        origin: (n, 3) where the quadrics are wanted.
        rows: (n,) where in the next two their neighbours are.
        distance, index: (any, k or more) nearest samples.
        k: how many of them are used.
        frame, coefficients, radius, error: as in `LocalQuadrics`, filled in.
        variance, foot: as in `Fits`, filled in.
    """
    room, chosen = room_for(k), np.ones(k, np.bool_)
    for i in range(start, stop):
        near = rows[i]
        radius[i], error[i], variance[i] = fit_one(
            samples, origin[i], distance[near], index[near], chosen, room, frame[i],
            coefficients[i],
        )  # fmt: skip
        site = float(origin[i, 0]), float(origin[i, 1]), float(origin[i, 2])
        foot[i, 0], foot[i, 1], foot[i, 2] = foot_on(i, site, origin, frame, coefficients, radius)


@compiled
def fit_chosen_rows(
    start: int, stop: int, samples: Array, origin: Array, distance: Array, index: Array,
    chosen: Array, frame: Array, coefficients: Array, radius: Array, error: Array,
) -> None:  # fmt: skip
    """Fits quadrics start..stop to the chosen (n, k) of their nearest samples; see `fit_rows`."""
    room = room_for(chosen.shape[1])
    for i in range(start, stop):
        radius[i], error[i], _ = fit_one(
            samples, origin[i], distance[i], index[i], chosen[i], room, frame[i], coefficients[i]
        )


@compiled
def room_for(k: int) -> Room:
    """What `fit_one` computes in, for up to k neighbours."""
    return (np.empty((k, 3)), np.empty(k), np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 6)),
            np.empty((2, 6)))  # fmt: skip


@compiled
def fit_one(
    samples: Array, site: Array, distance: Array, index: Array, chosen: Array, room: Room,
    frame: Array, coefficients: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """One fit to the chosen (k,) among the nearest samples, as `fits.by_tensors`.

    Fills in frame (3, 3) and coefficients (6,); tells the radius, error and variance.
    """
    local, weight, covariance, axes, normal, right = room
    radius = 1e-9
    for j in range(len(chosen)):
        if chosen[j]:
            radius = max(radius, float(distance[j]))
    for j in range(len(chosen)):
        ratio = float(distance[j]) / radius
        weight[j] = math.exp(-FALLOFF * ratio * ratio) if chosen[j] else 0.0
        for i in range(3):
            local[j, i] = (float(samples[index[j], i]) - float(site[i])) / radius
    _spread(local, weight, len(chosen), covariance)
    _principal(covariance, axes)
    for i in range(3):
        for j in range(3):
            frame[i, j] = axes[i, j]
    right[:] = 0.0
    right[1, 0] = 1.0
    _gather(local, weight, len(chosen), axes, normal, right[0])
    _decompose(normal)
    for i in range(2):
        _solve(normal, right[i])
    for i in range(6):
        coefficients[i] = right[0, i]
    influence = min(max(right[1, 0], 0.0), 0.999)
    error = abs(right[0, 0]) / (1 - influence) * radius
    return radius, error, _variance(local, weight, len(chosen), right[1])


@compiled
def _spread(local: Array, weight: Array, count: int, covariance: Array) -> None:
    """Fills in the weighted covariance (3, 3) of points around their mean, but for a factor."""
    total = x = y = z = xx = xy = xz = yy = yz = zz = 0.0
    for j in range(count):
        w, a, b, c = weight[j], local[j, 0], local[j, 1], local[j, 2]
        total += w
        x, y, z = x + w * a, y + w * b, z + w * c
        xx, xy, xz = xx + w * a * a, xy + w * a * b, xz + w * a * c
        yy, yz, zz = yy + w * b * b, yz + w * b * c, zz + w * c * c
    covariance[0, 0] = xx - x * x / total
    covariance[1, 1] = yy - y * y / total
    covariance[2, 2] = zz - z * z / total
    covariance[0, 1] = covariance[1, 0] = xy - x * y / total
    covariance[0, 2] = covariance[2, 0] = xz - x * z / total
    covariance[1, 2] = covariance[2, 1] = yz - y * z / total


@compiled
def _principal(matrix: Array, axes: Array) -> None:
    """Fills in the principal axes, rows from wide to narrow, by Jacobi's rotations."""
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
        off = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if off <= _SMALL * trace * trace:
            break
        _rotate(matrix, axes, 0, 1, 2)
        _rotate(matrix, axes, 0, 2, 1)
        _rotate(matrix, axes, 1, 2, 0)
    for first, second in ((0, 1), (1, 2), (0, 1)):
        if matrix[first, first] < matrix[second, second]:
            for j in range(3):
                axes[first, j], axes[second, j] = axes[second, j], axes[first, j]
            one, two = matrix[first, first], matrix[second, second]
            matrix[first, first], matrix[second, second] = two, one


@compiled
def _rotate(matrix: Array, axes: Array, p: int, q: int, other: int) -> None:
    """Turns axes p and q so that they are no longer correlated."""
    mixed = matrix[p, q]
    if mixed == 0.0:
        return
    slant = (matrix[q, q] - matrix[p, p]) / (2 * mixed)
    tangent = math.copysign(1.0, slant) / (abs(slant) + math.sqrt(slant * slant + 1))
    cosine = 1 / math.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    matrix[p, p] -= tangent * mixed
    matrix[q, q] += tangent * mixed
    matrix[p, q] = matrix[q, p] = 0.0
    a, b = matrix[other, p], matrix[other, q]
    matrix[other, p] = matrix[p, other] = cosine * a - sine * b
    matrix[other, q] = matrix[q, other] = sine * a + cosine * b
    for j in range(3):
        a, b = axes[p, j], axes[q, j]
        axes[p, j], axes[q, j] = cosine * a - sine * b, sine * a + cosine * b


@compiled
def _gather(
    local: Array, weight: Array, count: int, axes: Array, normal: Array, moments: Array
) -> None:
    """Turns points into their frame, and fills in the normal equations of the fit.

    Of (6, 6) only what is on and below the diagonal.
    """
    normal[:] = 0.0
    total = 0.0
    basis = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for j in range(count):
        x, y, z = local[j, 0], local[j, 1], local[j, 2]
        u = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
        v = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
        height = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
        local[j, 0], local[j, 1], local[j, 2] = u, v, height
        total += weight[j]
        basis = (1.0, u, v, u * u, u * v, v * v)
        for a in range(6):
            part = weight[j] * basis[a]
            moments[a] += part * height
            for b in range(a + 1):
                normal[a, b] += part * basis[b]
    for a in range(6):
        normal[a, a] += RIDGE[a] * total


@compiled
def _decompose(matrix: Array) -> None:
    """Cholesky's factor of a positive (6, 6) matrix, in place, on and below the diagonal."""
    for j in range(6):
        for i in range(j, 6):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(rest, 1e-300)) if i == j else rest / matrix[j, j]


@compiled
def _solve(factor: Array, right: Array) -> None:
    """Solves with Cholesky's factor, in place."""
    for i in range(6):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@compiled
def _variance(local: Array, weight: Array, count: int, inverse: Array) -> float:
    """Of the height at the site, in variances of the samples; inverse: the first row (6,)."""
    total = 0.0
    for j in range(count):
        u, v = local[j, 0], local[j, 1]
        share = weight[j] * (
            inverse[0] + inverse[1] * u + inverse[2] * v
            + inverse[3] * u * u + inverse[4] * u * v + inverse[5] * v * v
        )  # fmt: skip
        total += share * share
    return total


@compiled
def sum_up_rows(
    start: int, stop: int, values: Array, rows: Array, index: Array, k: int, quantile: float,
    result: Array,
) -> None:  # fmt: skip
    """Means, or quantiles, of values over neighbours.

    Args:
        start, stop: rows of the result.
        values: (m,) of all sites.
        rows: (n,) where in `index` the neighbours are.
        index: (any, k or more) sites around.
        k: how many of them are used.
        quantile: 0..1, or a negative number for the mean.
        result: (n,), filled in.
    """
    some = np.empty(k)
    for i in range(start, stop):
        near = index[rows[i]]
        total = 0.0
        for j in range(k):
            some[j] = values[near[j]]
            total += some[j]
        result[i] = _quantile(some, quantile) if quantile >= 0 else total / k


@compiled
def _quantile(values: Array, share: float) -> float:
    """Between the two values next to it; the values are sorted as far as it takes."""
    place = share * (len(values) - 1)
    last = min(int(place) + 1, len(values) - 1)
    for i in range(last + 1):
        least = i
        for j in range(i + 1, len(values)):
            if values[j] < values[least]:
                least = j
        values[i], values[least] = values[least], values[i]
    return float(values[int(place)] + (place - int(place)) * (values[last] - values[int(place)]))
