"""Small handles are cut out, what belongs to the surface stays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.handles import without_small_handles


def sheet(side: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A flat square of triangles in the plane z = 0."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return vertices, faces.reshape(-1, 3)


def with_handle(side: int, apart: int) -> Draft:
    """The sheet with two cells, `apart` cells from each other, joined by a bent tube."""
    vertices, faces = sheet(side)
    middle = side // 2
    corner = [middle * (side + 1) + middle, (middle + apart) * (side + 1) + middle]
    loops = [np.array([c, c + side + 1, c + side + 2, c + 1]) for c in corner]
    inside = [np.isin(faces, loop).all(axis=1) for loop in loops]
    faces = faces[~(inside[0] | inside[1])]
    raised = vertices[loops[0]] + [0.5 * apart, 0.0, 1.0]
    ring = len(vertices) + np.arange(4)
    mirrored = loops[1][[1, 0, 3, 2]]  # the tube turns over on its way
    tube = [joined(loops[0], ring), joined(ring, mirrored)]
    every = np.concatenate([faces, *tube])
    points = np.concatenate([vertices, raised])
    return Draft(points, every, np.zeros(len(points), dtype=bool))


def joined(one: NDArray[np.int64], two: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles between two loops of four."""
    after_one, after_two = np.roll(one, -1), np.roll(two, -1)
    return np.concatenate(
        [np.stack([one, after_one, two], axis=1), np.stack([after_one, after_two, two], axis=1)]
    )


def euler(draft: Draft) -> int:
    pairs = np.sort(draft.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique(pairs, axis=0)
    return len(np.unique(draft.faces)) - len(edges) + len(draft.faces)


def border_edges(draft: Draft) -> NDArray[np.int64]:
    pairs = np.sort(draft.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    return np.asarray(edges[count == 1])


@pytest.mark.parametrize("apart", [2, 3])
def test_a_small_handle_becomes_a_hole_that_can_be_closed(apart: int) -> None:
    draft = with_handle(16, apart)
    assert euler(draft) == -1
    result = without_small_handles(draft)
    assert euler(result) == 0  # a square with one hole
    assert len(border_edges(result)) > 4 * 16
    assert result.loose[border_edges(result)].sum() > 0
    assert result.vertices[:, 2].max() == 0.0


def test_a_large_handle_stays() -> None:
    draft = with_handle(40, 16)
    result = without_small_handles(draft)
    np.testing.assert_array_equal(result.faces, draft.faces)


def test_a_mere_fold_stays() -> None:
    vertices, faces = sheet(12)
    vertices[6 * 13 + 6] += [1.6, 0.0, 0.1]
    draft = Draft(vertices, faces, np.zeros(len(vertices), dtype=bool))
    assert without_small_handles(draft).faces is draft.faces


def test_a_flat_sheet_is_given_back() -> None:
    draft = Draft(*sheet(8), np.zeros(81, dtype=bool))
    assert without_small_handles(draft) is draft
