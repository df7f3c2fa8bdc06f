"""Feet near creases, query by query: `creases` as compiled loops."""

from __future__ import annotations

import math

import numpy as np

from udflow.cloud.creases import (
    BEHIND,
    DISSENT,
    LOCAL,
    NEAR,
    OFF,
    ON_DATA,
    OVERSHOOT,
    ROUNDS,
    SAME_PIECE,
    SURELY_ON,
    TURNED,
    WAY,
)
from udflow.cloud.quadric_geometry import (
    Vector,
    dot,
    foot_on,
    height_over,
    in_frame,
    minus,
    norm,
    normal_at,
    on_planes,
    row_of,
)
from udflow.compiled import Array, compiled


@compiled
def is_creased(near: Array, distance: float, spacing: float, frame: Array) -> bool:
    """As `Candidates.creased`."""
    if distance >= NEAR * spacing:
        return False
    first = row_of(frame[near[0]], 2)
    for j in range(1, len(near)):
        if abs(dot(first, row_of(frame[near[j]], 2))) < TURNED:
            return True
    return False


@compiled
def compare(
    near: Array, feet: Array, spacing: float, origin: Array, frame: Array, coefficients: Array,
    radius: Array, of_foot: Array, of_site: Array, turned: Array, beyond: Array,
) -> None:  # fmt: skip
    """Fills in (c, c) for quadrics k and j: the height of j's site over k, whether the two are
    different pieces, and for those the height of j's foot and whether it lies beyond k. See
    `creases`."""
    count = len(near)
    for k in range(count):
        for j in range(count):
            site = in_frame(near[k], row_of(origin, near[j]), origin, frame, radius)
            of_site[k, j] = height_over(near[k], site, coefficients, radius)
            led_to = normal_at(near[k], site, frame, coefficients)
            turned[k, j] = abs(dot(led_to, row_of(frame[near[j]], 2))) < TURNED
    for k in range(count):
        for j in range(k):
            turned[k, j] = turned[j, k] = turned[k, j] and turned[j, k]
    for k in range(count):
        for j in range(count):
            beyond[k, j] = False
            if turned[k, j]:
                foot = in_frame(near[k], row_of(feet, j), origin, frame, radius)
                of_foot[k, j] = height_over(near[k], foot, coefficients, radius)
                beyond[k, j] = _ends(k, j, near, feet, spacing, origin, of_foot, of_site, turned)


@compiled
def _ends(
    k: int, j: int, near: Array, feet: Array, spacing: float, origin: Array, of_foot: Array,
    of_site: Array, turned: Array,
) -> bool:  # fmt: skip
    """Whether quadric k ends piece j before its foot."""
    apart = norm(minus(row_of(feet, j), row_of(origin, near[k])))
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
def foot_at_crease(
    near: Array, point: Vector, feet: Array, share: Array, spacing: float, origin: Array,
    frame: Array, coefficients: Array, radius: Array, of_foot: Array, turned: Array,
    beyond: Array,
) -> Vector:  # fmt: skip
    """As `feet_at_creases`."""
    count = len(near)
    least = np.inf
    for j in range(count):
        least = min(least, norm(minus(row_of(feet, j), point)))
    lead, shortest = -1, np.inf
    valid, supported = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for j in range(count):
        supported[j] = _supported(j, near, feet, spacing, origin, turned)
        length = norm(minus(row_of(feet, j), point))
        reached = length < least + BEHIND * spacing and not beyond[:, j].any()
        valid[j] = reached and supported[j]
        if valid[j] and length < shortest:
            lead, shortest = j, length
    if lead < 0:
        return _where_two_meet(near, point, feet, share, spacing, origin, frame, coefficients,
                               radius, of_foot, beyond, supported)  # fmt: skip
    allowed = np.zeros(count)
    for j in range(count):
        if valid[j] and not turned[lead, j]:
            allowed[j] = share[j]
    return blended(feet, row_of(feet, lead), allowed, spacing)


@compiled
def _where_two_meet(
    near: Array, point: Vector, feet: Array, share: Array, spacing: float, origin: Array,
    frame: Array, coefficients: Array, radius: Array, of_foot: Array, beyond: Array,
    supported: Array,
) -> Vector:  # fmt: skip
    """As `creases._where_two_meet`."""
    crossed, highest = 0, -1.0
    for k in range(len(near)):
        if beyond[k, 0] and abs(of_foot[k, 0]) > highest:
            crossed, highest = k, abs(of_foot[k, 0])
    one, two = near[0], near[crossed]
    foot = row_of(feet, 0)
    for _ in range(ROUNDS):
        on_one = foot_on(one, foot, origin, frame, coefficients, radius)
        on_two = foot_on(two, foot, origin, frame, coefficients, radius)
        a = normal_at(one, in_frame(one, on_one, origin, frame, radius), frame, coefficients)
        b = normal_at(two, in_frame(two, on_two, origin, frame, radius), frame, coefficients)
        foot = on_planes(point, on_one, a, on_two, b)
    lone = blended(feet, row_of(feet, 0), share, spacing)
    if norm(minus(foot, lone)) <= WAY * spacing:
        return foot
    return lone if supported[0] else _nearest_supported(near, point, feet, origin, supported)


@compiled
def _supported(
    j: int, near: Array, feet: Array, spacing: float, origin: Array, turned: Array
) -> bool:
    """As `creases._supported`."""
    foot = row_of(feet, j)
    x = y = z = 0.0
    for i in range(len(near)):
        if not turned[j, i]:
            offset = minus(row_of(origin, near[i]), foot)
            x, y, z = x + offset[0], y + offset[1], z + offset[2]
    towards, closest = (x, y, z), np.inf
    length = max(norm(towards), 1e-18)
    for i in range(len(near)):
        if not turned[j, i]:
            offset = minus(row_of(origin, near[i]), foot)
            closest = min(closest, dot(offset, towards) / length)
    surely = closest < SURELY_ON * spacing
    near_site = _from_site(foot, near, origin) < ON_DATA * spacing
    return surely or (near_site and closest < OVERSHOOT * spacing)


@compiled
def _from_site(foot: Vector, near: Array, origin: Array) -> float:
    """Distance of a foot from the nearest site."""
    least = np.inf
    for j in range(len(near)):
        least = min(least, norm(minus(foot, row_of(origin, near[j]))))
    return least


@compiled
def _nearest_supported(
    near: Array, point: Vector, feet: Array, origin: Array, supported: Array
) -> Vector:
    """The nearest foot that its piece supports; the nearest site where there is none."""
    best, least = row_of(origin, near[0]), np.inf
    for j in range(len(near)):
        way = norm(minus(row_of(feet, j), point))
        if way < least and supported[j]:
            best, least = row_of(feet, j), way
    return best


@compiled
def blended(feet: Array, lead: Vector, share: Array, spacing: float) -> Vector:
    """As `Candidates.blended`; share (c,) is the weight by the closeness of the sites."""
    x = y = z = total = 0.0
    for j in range(len(share)):
        dissent = norm(minus(row_of(feet, j), lead)) / (DISSENT * spacing)
        weight = share[j] * math.exp(-dissent * dissent)
        x, y, z = x + weight * feet[j, 0], y + weight * feet[j, 1], z + weight * feet[j, 2]
        total += weight
    total = max(total, 1e-12)
    return x / total, y / total, z / total
