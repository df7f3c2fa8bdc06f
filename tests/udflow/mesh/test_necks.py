"""False necks are cut and closed; what the surface really has stays."""

from __future__ import annotations

import numpy as np
from grids import (
    borders,
    cell,
    consistent,
    draft,
    euler,
    pieces,
    samples_on,
    sheet,
    tower,
    two_sheets,
    with_tube,
    without_cell,
)
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.necks import without_necks
from udflow.mesh.support import SampleSet

SIDE = 24
SPACING = 2.0


def untouched(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points


def repaired(mesh: Draft, spacing: float = SPACING) -> Draft:
    samples = samples_on(mesh.vertices, mesh.faces, spacing)
    return without_necks(mesh, SampleSet.of(samples, 0.1), untouched)


def test_a_tunnel_through_a_thin_plate_is_closed() -> None:
    mesh = with_tube(*two_sheets(SIDE, 1.0, closed=True), cell(SIDE, 12, 12))
    assert (euler(mesh), consistent(mesh)) == (0, True)
    result = repaired(mesh)
    assert (euler(result), pieces(result), borders(result)) == (2, 1, 0)
    assert consistent(result)


def test_two_sheets_joined_by_a_tube_come_apart() -> None:
    mesh = with_tube(*two_sheets(SIDE, 1.5, closed=False), cell(SIDE, 8, 14))
    assert (pieces(mesh), borders(mesh)) == (1, 2)
    result = repaired(mesh)
    assert (pieces(result), borders(result), euler(result)) == (2, 2, 2)
    assert consistent(result)


def test_a_tunnel_that_samples_can_show_stays() -> None:
    mesh = with_tube(*two_sheets(SIDE, 1.0, closed=True), cell(SIDE, 12, 12))
    assert repaired(mesh, spacing=0.7) is mesh


def test_a_thin_limb_stays() -> None:
    mesh = tower(*sheet(SIDE), cell(SIDE, 12, 12), height=16)
    assert repaired(mesh, spacing=1.5) is mesh


def test_a_small_hole_is_no_neck() -> None:
    vertices, faces = sheet(SIDE)
    vertices[:, 2] = 0.05 * (vertices[:, 0] - SIDE / 2) ** 2  # curved, so that it is examined
    mesh = draft(vertices, without_cell(faces, cell(SIDE, 12, 12)))
    assert repaired(mesh) is mesh
