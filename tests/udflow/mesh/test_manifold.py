"""Sheets that touch come apart, scraps come off, true junctions stay."""

from __future__ import annotations

import numpy as np
from grids import borders, consistent, draft, euler, pieces, sheet
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.manifold import separated
from udflow.mesh.topology import edges_of

SIDE = 20


def with_fin(first: int, last: int) -> Draft:
    """A sheet with an upright fin, a cell high, along part of its middle line."""
    vertices, faces = sheet(SIDE)
    foot = 10 * (SIDE + 1) + np.arange(first, last + 1)
    top = len(vertices) + np.arange(len(foot))
    fin: NDArray[np.int64] = np.concatenate(
        [
            np.stack([foot[:-1], foot[1:], top[:-1]], axis=1),
            np.stack([foot[1:], top[1:], top[:-1]], axis=1),
        ]
    )
    vertices = np.concatenate([vertices, vertices[foot] + np.array([0.0, 0.0, 1.0])])
    return draft(vertices, np.concatenate([faces, fin]))


def test_a_scrap_of_a_third_sheet_comes_off() -> None:
    mesh = with_fin(9, 11)
    assert edges_of(mesh.faces).count.max() == 3
    result = separated(mesh, spacing=1.0)
    assert consistent(result)
    assert (pieces(result), borders(result), euler(result)) == (2, 2, 2)


def test_a_long_junction_stays() -> None:
    mesh = with_fin(2, 18)
    result = separated(mesh, spacing=1.0)
    assert (edges_of(result.faces).count == 3).sum() == 16


def test_sheets_that_touch_along_an_edge_come_apart() -> None:
    vertices, faces = sheet(SIDE)
    bent = vertices.copy()
    bent[:, 2] = np.abs(vertices[:, 0] - 10.0) + 0.2 * np.abs(vertices[:, 1] - 10.5)
    shared = 10 * (SIDE + 1) + np.array([10, 11])
    bent[shared, 2] = 0.0
    number = np.arange(len(vertices)) + len(vertices)
    number[shared] = shared
    mesh = draft(np.concatenate([vertices, bent]), np.concatenate([faces, number[faces]]))
    assert edges_of(mesh.faces).count.max() == 4
    result = separated(mesh, spacing=1.0)
    assert consistent(result)
    assert (pieces(result), euler(result)) == (2, 2)


def test_sheets_that_touch_in_a_vertex_come_apart() -> None:
    vertices, faces = sheet(SIDE)
    number = np.arange(len(vertices)) + len(vertices)
    number[220] = 220
    lifted = vertices + np.array([0.0, 0.0, 1.0])
    mesh = draft(np.concatenate([vertices, lifted]), np.concatenate([faces, number[faces]]))
    result = separated(mesh, spacing=1.0)
    assert (pieces(result), euler(result)) == (2, 2)
