"""Holes that are failures of extraction are closed, holes in the data stay."""

from __future__ import annotations

import numpy as np
import pytest
from grids import borders, consistent, draft, euler, samples_on, sheet
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.filling import least_filling
from udflow.mesh.holes import closed
from udflow.mesh.support import SampleSet

SIDE = 32
CENTRE = np.array([16.0, 16.0, 0.0])


def on_floor(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points * [1.0, 1.0, 0.0]


def holed(radius: float) -> Draft:
    vertices, faces = sheet(SIDE)
    away = np.linalg.norm(vertices[faces].mean(axis=1) - CENTRE, axis=1)
    return draft(vertices, faces[away > radius]).compacted()


def repaired(radius: float, *, data_end: bool, spacing: float = 2.0) -> Draft:
    """A sheet with a hole, given samples of the whole sheet or of what lies beside the hole."""
    points = samples_on(*sheet(SIDE), spacing)
    if data_end:
        points = points[np.linalg.norm(points - CENTRE, axis=1) > radius + 2]
    return closed(holed(radius), SampleSet.of(points, 0.1), on_floor)


@pytest.mark.parametrize("data_end", [False, True])
def test_a_hole_too_small_to_show_in_samples_is_closed(data_end: bool) -> None:
    result = repaired(1.5, data_end=data_end)
    assert (borders(result), euler(result)) == (1, 1)
    assert consistent(result)


def test_a_hole_in_the_data_stays() -> None:
    result = repaired(7.0, data_end=True)
    assert (borders(result), euler(result)) == (2, 0)


def test_a_hole_with_samples_on_it_is_closed() -> None:
    result = repaired(7.0, data_end=False)
    assert (borders(result), euler(result)) == (1, 1)
    assert np.abs(result.vertices[:, 2]).max() == 0.0


def test_the_border_of_the_sheet_stays() -> None:
    result = repaired(1.5, data_end=False)
    corners = np.abs(result.vertices - CENTRE).max(axis=1) == SIDE / 2
    assert corners.sum() == 4 * SIDE


def test_the_least_filling_of_a_flat_loop_is_its_area() -> None:
    angle = np.arange(40) * 2 * np.pi / 40
    star = np.where(np.arange(40) % 2, 1.0, 0.5)[:, None] * np.stack(
        [np.cos(angle), np.sin(angle), np.zeros(40)], axis=1
    )
    faces, area = least_filling(star)
    exact = 20 * 0.5 * np.sin(2 * np.pi / 40)  # two triangles for each tip, sides 1 and 0.5
    assert area == pytest.approx(exact)
    a, b, c = (star[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_the_least_filling_avoids_chords_that_are_taken() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    taken = np.zeros((4, 4), dtype=bool)
    taken[0, 2] = taken[2, 0] = True
    faces, area = least_filling(square, taken)
    assert sorted(map(sorted, faces.tolist())) == [[0, 1, 3], [1, 2, 3]]
    assert area == pytest.approx(1.0)
    taken[1, 3] = taken[3, 1] = True
    faces, area = least_filling(square, taken)
    assert len(faces) == 0
    assert area == np.inf
