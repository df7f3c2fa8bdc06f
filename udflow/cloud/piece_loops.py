"""One piece of surface for each quadric, site by site: `pieces` as a compiled loop."""

from __future__ import annotations

import math

import numpy as np

from udflow.cloud.fit_loops import fit_one, room_for
from udflow.cloud.quadric_geometry import height_over, in_frame
from udflow.compiled import Array, compiled


@compiled
def piece_rows(
    start: int, stop: int, rows: Array, samples: Array, origin: Array, frame: Array,
    coefficients: Array, radius: Array, tolerance: Array, distance: Array, index: Array,
    around: Array, limits: tuple[int, int, int, float, float, int],
    new_frame: Array, new_coefficients: Array, new_radius: Array, new_count: Array, doubtful: Array,
) -> None:  # fmt: skip
    """Judges the quadrics rows[start..stop], and fits those again that a piece explains better.

    Args:
        start, stop: what to go through of `rows`.
        rows: (d,) quadrics in doubt.
        samples: (m, 3) the data.
        origin, frame, coefficients, radius: (n, ...) as in `LocalQuadrics`.
        tolerance: (n,) distance up to which a sample is on a quadric.
        distance, index: (n, any) nearest samples.
        around: (n, any) nearest sites.
        limits: how many samples judge, how many are looked through, how many hypotheses; what
            share is to be on a quadric, how much better a piece is, and its fewest samples.
        new_frame, new_coefficients, new_radius, new_count: (n, ...) changed where fitted again.
        doubtful: (d,) bool, filled in.
    """
    close, pool, hypotheses, whole, gain, fewest = limits
    room, weight, piece = room_for(pool), np.empty(pool), np.empty(pool, np.bool_)
    for i in range(start, stop):
        row = rows[i]
        near, limit = index[row], float(tolerance[row])
        weigh(distance[row], close, weight)
        share = _share(
            row, samples, near, close, weight, limit, origin, frame, coefficients, radius
        )
        doubtful[i] = share < whole
        if not doubtful[i]:
            continue
        weigh(distance[row], pool, weight)
        chosen, own = row, _explained(row, samples, near, weight, limit, origin, frame,
                                      coefficients, radius, piece)  # fmt: skip
        best = own
        for j in range(hypotheses):
            score = _explained(around[row, j], samples, near, weight, limit, origin, frame,
                               coefficients, radius, piece)  # fmt: skip
            if score > best:
                chosen, best = around[row, j], score
        if best <= gain * own or best <= 0:
            continue
        _explained(chosen, samples, near, weight, limit, origin, frame, coefficients, radius, piece)
        if piece.sum() < fewest:
            continue
        new_radius[row], _, _ = fit_one(
            samples, origin[row], distance[row], near, piece, room, new_frame[row],
            new_coefficients[row],
        )  # fmt: skip
        new_count[row] = piece.sum()


@compiled
def weigh(distance: Array, count: int, weight: Array) -> None:
    """Fills in the weights of the nearest samples."""
    last = max(float(distance[count - 1]), 1e-12)
    for j in range(count):
        ratio = float(distance[j]) / last
        weight[j] = math.exp(-ratio * ratio)


@compiled
def missed_by(
    quadric: int, samples: Array, sample: int, origin: Array, frame: Array, coefficients: Array,
    radius: Array,
) -> float:  # fmt: skip
    """How far a sample is from a quadric, along the quadric's own w."""
    point = float(samples[sample, 0]), float(samples[sample, 1]), float(samples[sample, 2])
    local = in_frame(quadric, point, origin, frame, radius)
    return abs(height_over(quadric, local, coefficients, radius))


@compiled
def _share(
    row: int, samples: Array, near: Array, count: int, weight: Array, limit: float,
    origin: Array, frame: Array, coefficients: Array, radius: Array,
) -> float:  # fmt: skip
    """Weighted share of the nearest samples that a quadric explains, 0 if it misses the first."""
    on = total = 0.0
    for j in range(count):
        off = missed_by(row, samples, near[j], origin, frame, coefficients, radius)
        if j == 0 and off > limit:
            return 0.0
        on += weight[j] if off < limit else 0.0
        total += weight[j]
    return on / total


@compiled
def _explained(
    quadric: int, samples: Array, near: Array, weight: Array, limit: float, origin: Array,
    frame: Array, coefficients: Array, radius: Array, piece: Array,
) -> float:  # fmt: skip
    """How much of a neighbourhood a quadric explains, and in `piece` (k,) which samples."""
    score = 0.0
    for j in range(len(piece)):
        off = missed_by(quadric, samples, near[j], origin, frame, coefficients, radius) / limit
        piece[j] = off < 1
        if j == 0 and not piece[0]:
            return 0.0
        score += max(0.0, 1 - off * off) * weight[j]
    return score
