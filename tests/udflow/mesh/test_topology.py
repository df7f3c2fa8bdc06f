"""Edges of polygons, dealt out by a loop, against those that sorting finds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from udflow.mesh.topology import Edges, edges_of, faces_around, with_any


def edges_by_sorting(faces: NDArray[np.int64]) -> Edges:
    """The same, in steps over whole arrays."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(faces.max(initial=0)) + 1) + high
    sides = np.argsort(key, kind="stable")
    ordered = key[sides]
    is_first = np.ones(len(ordered), dtype=bool)
    is_first[1:] = ordered[1:] != ordered[:-1]
    first = np.flatnonzero(is_first)
    leader = sides[first]
    ends = np.stack([low[leader], high[leader]], axis=1)
    return Edges(ends, np.append(first, len(ordered)), sides)


def polygons(count: int, corners: int, vertices: int, seed: int = 0) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, vertices, (count, corners))


@pytest.mark.parametrize(
    "faces",
    [
        np.zeros((0, 3), np.int64),
        np.array([[0, 1, 2], [2, 1, 3], [4, 2, 1]]),
        polygons(60, 3, 50),
        polygons(900, 4, 9),  # many sides at a vertex
        polygons(5_000, 3, 2_000)[:, ::-1],  # not in the order of memory
    ],
    ids=["none", "fan", "few", "crowded", "turned"],
)
def test_edges_are_those_that_sorting_finds(faces: NDArray[np.int64]) -> None:
    found, expected = edges_of(faces), edges_by_sorting(faces)
    for name in ("ends", "first", "sides"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.count.sum() == faces.size


def test_polygons_with_any_chosen_corner() -> None:
    faces, chosen = polygons(300, 4, 40), np.arange(40) % 7 == 0
    np.testing.assert_array_equal(with_any(faces, chosen), chosen[faces].any(axis=1))


@pytest.mark.parametrize("corners", [3, 4])
def test_faces_around_vertices(corners: int) -> None:
    faces = polygons(200, corners, 50, seed=1)
    first, around = faces_around(faces, 55)
    order = np.argsort(faces.reshape(-1), kind="stable")
    np.testing.assert_array_equal(around, order // corners)
    expected = np.searchsorted(faces.reshape(-1)[order], np.arange(56))
    np.testing.assert_array_equal(first, expected)
