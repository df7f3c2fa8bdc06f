"""Cross-caps are cut out, a Möbius strip that the samples show stays."""

from __future__ import annotations

import numpy as np
import pytest
from grids import Faces, Points, cell, sheet
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from udflow.mesh.crosscap_loops import MOST, turning_ways
from udflow.mesh.crosscaps import LONGEST, neighbours, without_crosscaps
from udflow.mesh.draft import Draft
from udflow.mesh.orientation import oriented
from udflow.mesh.topology import edges_of

SPACING = 1.5  # edges between samples: 7 spacings lead around a cross-cap of eight edges


def draft_of(vertices: Points, faces: Faces) -> Draft:
    return Draft(vertices, faces, np.ones(len(vertices), dtype=bool)).compacted()


def with_crosscap(side: int) -> Draft:
    """A sheet without the four cells in its middle, the opposite places of that border joined."""
    vertices, faces = sheet(side)
    middle = side // 2
    inside = [cell(side, middle + i, middle + j) for i in (-1, 0) for j in (-1, 0)]
    gone = np.zeros(len(faces), dtype=bool)
    for corners in inside:
        gone |= np.isin(faces, corners).all(axis=1)
    centre = middle * (side + 1) + middle
    around = [(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)]
    border = np.array([centre + i * (side + 1) + j for i, j in around])
    number = np.arange(len(vertices))
    number[border[4:]] = border[:4]
    return draft_of(vertices, number[faces[~gone]])


def strip(length: int, width: int) -> Draft:
    """A Möbius strip of length x width cells with edges of about 1."""
    u, v = np.meshgrid(np.arange(length), np.arange(width + 1) - width / 2, indexing="ij")
    angle, ring = 2 * np.pi * u / length, length / (2 * np.pi)
    away = ring + v * np.cos(angle / 2)
    places = [away * np.cos(angle), away * np.sin(angle), v * np.sin(angle / 2)]
    number = np.arange(u.size).reshape(u.shape)
    number = np.concatenate([number, number[:1, ::-1]])
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return draft_of(np.stack(places, axis=-1).reshape(-1, 3), faces.reshape(-1, 3))


def euler(draft: Draft) -> int:
    return len(np.unique(draft.faces)) - len(edges_of(draft.faces).ends) + len(draft.faces)


def one_sided(draft: Draft) -> bool:
    faces = oriented(draft.vertices, draft.faces, edges_of(draft.faces))
    return bool(neighbours(faces)[1].any())


@pytest.mark.parametrize("side", [8, 20])
def test_a_crosscap_becomes_a_hole(side: int) -> None:
    draft = with_crosscap(side)
    assert euler(draft) == 0
    assert one_sided(draft)
    result = without_crosscaps(draft, SPACING)
    assert not one_sided(result)
    assert not neighbours(result.faces)[1].any()
    assert euler(result) == 0  # a square with one hole
    assert (edges_of(result.faces).count == 1).sum() > 4 * side
    assert len(result.faces) > len(draft.faces) - 40


def test_several_crosscaps_are_cut_out() -> None:
    one, two = with_crosscap(12), with_crosscap(12)
    faces = np.concatenate([one.faces, two.faces + len(one.vertices)])
    result = without_crosscaps(
        draft_of(np.concatenate([one.vertices, two.vertices]), faces), SPACING
    )
    assert not one_sided(result)
    assert euler(result) == 0


def test_a_moebius_strip_that_the_samples_show_stays() -> None:
    draft = strip(int(4 * LONGEST), 4)
    result = without_crosscaps(draft, 1.0)
    assert one_sided(result)
    np.testing.assert_array_equal(np.sort(result.faces, axis=1), np.sort(draft.faces, axis=1))


def test_a_surface_with_two_sides_is_only_turned() -> None:
    vertices, faces = sheet(6)
    assert without_crosscaps(draft := draft_of(vertices, faces), 1.0) is draft
    some = faces.copy()
    some[::3] = some[::3, ::-1]
    result = without_crosscaps(draft_of(vertices, some), 1.0)
    assert not neighbours(result.faces)[1].any()
    np.testing.assert_array_equal(np.sort(result.faces, axis=1), np.sort(faces, axis=1))


@pytest.mark.parametrize("part", [1.0, 0.5])
def test_the_ways_are_the_shortest_of_the_double_cover(part: float) -> None:
    draft = strip(17, 5)
    generator = np.random.default_rng(0)
    centres = draft.vertices[draft.faces].mean(axis=1) + generator.normal(size=(170, 3)) / 5
    beyond, turned = neighbours(draft.faces)
    count = len(beyond)
    face, side = np.nonzero(beyond >= 0)
    other, turn = beyond[face, side], turned[face, side]
    apart = np.tile(np.linalg.norm(centres[face] - centres[other], axis=1), 2)
    start = np.concatenate([face, face + count])
    end = np.concatenate([other + count * turn, other + count * ~turn])
    graph = coo_matrix((apart, (start, end)), shape=(2 * count, 2 * count)).tocsr()
    expected = np.diagonal(dijkstra(graph, indices=np.arange(count))[:, count:])

    longest = float(np.quantile(expected, part)) + 1e-9
    way, size = np.zeros((count, MOST), dtype=np.int64), np.zeros(count, dtype=np.int64)
    length = np.full(count, np.inf)
    turning_ways(
        0, count, np.arange(count), longest, centres, beyond, turned, way, size, length
    )  # fmt: skip
    np.testing.assert_allclose(length, np.where(expected <= longest, expected, np.inf))
    np.testing.assert_array_equal(size > 0, expected <= longest)
    assert (size > 0).mean() == pytest.approx(part, abs=0.05)
    for faces in (row[:n] for row, n in zip(way, size, strict=True) if n > 0):
        assert (beyond[faces] == np.roll(faces, -1)[:, None]).any(axis=1).all()
