"""Making shared edges and vertices manifold where sheets merely touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.topology import parts, side_ends

_ROUNDS = 4
LONG_JUNCTION = 12.0  # spacings from end to end: three sheets that meet so far do meet
_ASIDE = 0.02  # of the way into its faces that the middle of a doubled edge moves


def separated(draft: Draft, spacing: float) -> Draft:
    """The mesh with sheets that touch taken apart.

    Edges with four faces are the touch of two sheets: one of them gets the edge's middle as a
    vertex of its own. Edges with three faces are true junctions if many of them make a long line.
    Else a scrap of sheet ends there, and the two faces that belong together leave it. Vertices at
    which several fans of faces meet are doubled.

    Args:
        draft: oriented triangles.
        spacing: of the samples.
    """
    if not draft.loose.any():
        return draft
    for _ in range(_ROUNDS):
        divided = draft
        for count in (4, 3, 5, 6):
            divided = _with_sheets_apart(divided, count, LONG_JUNCTION * spacing)
        if divided is draft:
            break
        draft = divided
    return _with_fans_apart(draft)


def _with_sheets_apart(draft: Draft, count: int, long: float) -> Draft:
    """One pair of faces taken from each edge that has `count` of them."""
    edges = draft.loose_edges()
    sides = edges.sides_where(count)
    if len(sides) > 0 and count % 2 == 1:
        ends = edges.ends[edges.count == count]
        sides = sides[~_in_long_lines(draft.vertices, ends, long)]
    if len(sides) == 0:
        return draft
    # a face may lie at two such edges: one now, the other in the next round
    face = sides // 3
    owner = np.full(len(draft.faces), len(sides))
    np.minimum.at(owner, face.reshape(-1), np.repeat(np.arange(len(sides)), count))
    sides = sides[(owner[face] == np.arange(len(sides))[:, None]).all(axis=1)]
    pair = _second_sheet(draft, sides)
    start, end = side_ends(draft.faces, pair)
    opposite = _opposite(draft.faces, pair)
    ends = 0.5 * (draft.vertices[start[:, 0]] + draft.vertices[end[:, 0]])
    middle = (1 - _ASIDE) * ends + _ASIDE * draft.vertices[opposite].mean(axis=1)
    number = (len(draft.vertices) + np.arange(len(pair)))[:, None].repeat(2, axis=1)
    faces = draft.faces.copy()
    faces[pair // 3] = np.stack([start, number, opposite], axis=2)
    added = np.stack([number, end, opposite], axis=2).reshape(-1, 3)
    return draft.replaced(middle, np.concatenate([faces, added]))


def _in_long_lines(
    vertices: NDArray[np.float64], ends: NDArray[np.int64], long: float
) -> NDArray[np.bool_]:
    """(e,) whether edges hang together in lines at least this long from end to end."""
    line = parts(ends, len(vertices))[ends[:, 0]]
    number, line = np.unique(line, return_inverse=True)
    low = np.full((len(number), 3), np.inf)
    high = -low
    for column in ends.T:
        np.minimum.at(low, line, vertices[column])
        np.maximum.at(high, line, vertices[column])
    result: NDArray[np.bool_] = (np.linalg.norm(high - low, axis=1) >= long)[line]
    return result


def _second_sheet(draft: Draft, sides: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 2) sides of one sheet at edges with (n, k) sides.

    Around the edge the faces of a sheet are neighbours in angle. Of all such pairs the one is
    taken whose faces agree in orientation, and of several the flattest; where four faces make two
    pairs, those of both count.
    """
    start, end = side_ends(draft.faces, sides)
    forward = start < end
    low, high = np.minimum(start, end)[:, 0], np.maximum(start, end)[:, 0]
    origin = draft.vertices[low]
    axis = draft.vertices[high] - origin
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-30)
    arm = draft.vertices[_opposite(draft.faces, sides)] - origin[:, None]
    arm -= np.einsum("kij,kj->ki", arm, axis)[..., None] * axis[:, None]
    across = np.cross(axis, arm[:, 0])
    angle = np.arctan2(
        np.einsum("kij,kj->ki", arm, across), np.einsum("kij,kj->ki", arm, arm[:, 0])
    )
    order = np.argsort(angle, axis=1, kind="stable")
    turn, forward, sides = (
        np.take_along_axis(values, order, axis=1) for values in (angle, forward, sides)
    )
    gap = np.diff(turn, axis=1, append=turn[:, :1] + 2 * np.pi)
    agree = forward != np.roll(forward, -1, axis=1)
    score = agree - np.abs(gap - np.pi) / (4 * np.pi)
    if sides.shape[1] == 4:
        score += np.roll(score, 2, axis=1)
    best = score.argmax(axis=1)[:, None]
    pair = np.concatenate([best, (best + 1) % sides.shape[1]], axis=1)
    return np.take_along_axis(sides, pair, axis=1)


def _opposite(faces: NDArray[np.int64], sides: NDArray[np.int64]) -> NDArray[np.int64]:
    """The corner of its face that a side does not touch."""
    return faces.reshape(-1)[sides - sides % 3 + (sides + 2) % 3]


def _with_fans_apart(draft: Draft) -> Draft:
    edges = draft.loose_edges()
    corner = np.flatnonzero(draft.loose[draft.faces.reshape(-1)])
    place = np.full(draft.faces.size, -1)
    place[corner] = np.arange(len(corner))
    inner = np.repeat(edges.count > 1, edges.count)
    leader = np.repeat(edges.sides[edges.first[:-1]], edges.count)[inner]
    pairs = _corners_joined(draft.faces, leader, edges.sides[inner])
    pairs = place[pairs]
    fan = parts(pairs[(pairs >= 0).all(axis=1)], len(corner))
    vertex = draft.faces.reshape(-1)[corner]
    # the first fan of a vertex keeps it, the others get copies
    fans, first = np.unique(fan, return_index=True)
    owner = vertex[first]
    order = np.lexsort((fans, owner))
    again = np.zeros(len(fans), dtype=bool)
    again[order[1:]] = owner[order[1:]] == owner[order[:-1]]
    number = np.where(again, len(draft.vertices) + np.cumsum(again) - 1, owner)
    faces = draft.faces.copy().reshape(-1)
    faces[corner] = number[fan]
    return draft.replaced(draft.vertices[owner[again]], faces.reshape(-1, 3))


def _corners_joined(
    faces: NDArray[np.int64], one: NDArray[np.int64], two: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(2k, 2) corners (3f + c) that two sides on the same edge bring together."""
    start_one, start_two = one, two
    end_one, end_two = (side - side % 3 + (side + 1) % 3 for side in (one, two))
    corners = faces.reshape(-1)
    same = corners[start_one] == corners[start_two]
    partner_start = np.where(same, start_two, end_two)
    partner_end = np.where(same, end_two, start_two)
    return np.concatenate(
        [np.stack([start_one, partner_start], axis=1), np.stack([end_one, partner_end], axis=1)]
    )
