"""The sparse lattice against dictionaries and sets."""

from __future__ import annotations

import itertools

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from udflow.fields.lattice import SparseLattice, neighbour_offsets, occupied_mask

Point = tuple[int, int, int]
Shape = tuple[int, int, int]

SIDES = st.integers(1, 19)  # up to three leaf blocks along an axis
SHAPES = st.tuples(SIDES, SIDES, SIDES)


@st.composite
def lattices(draw: st.DrawFn) -> tuple[Shape, list[Point]]:
    """A shape and distinct points inside it, in any order."""
    shape = draw(SHAPES)
    point = st.tuples(*(st.integers(0, side - 1) for side in shape))
    return shape, draw(st.lists(point, unique=True, max_size=60))


def tensor(points: list[Point]) -> Tensor:
    return torch.tensor(points, dtype=torch.int64).reshape(-1, 3)


def as_set(lattice: SparseLattice) -> set[Point]:
    return {(x, y, z) for x, y, z in lattice.coordinates.tolist()}


@settings(deadline=None, max_examples=60)
@given(lattices(), st.lists(st.tuples(*3 * [st.integers(-4, 24)]), max_size=60))
def test_a_look_up_is_that_of_a_dictionary(case: tuple[Shape, list[Point]], others: list[Point]):
    shape, points = case
    lattice = SparseLattice.from_distinct(tensor(points), shape)
    number = {point: i for i, point in enumerate(points)}
    asked = points + others
    expected = [number.get(point, -1) for point in asked]
    assert lattice.find_by_loop(tensor(asked)).tolist() == expected
    assert lattice.find_by_tensors(tensor(asked)).tolist() == expected
    assert len(lattice) == len(points)


@settings(deadline=None, max_examples=60)
@given(lattices(), st.integers(0, 3))
def test_dilation_is_that_of_a_set(case: tuple[Shape, list[Point]], radius: int) -> None:
    shape, points = case
    steps = list(itertools.product(range(-radius, radius + 1), repeat=3))
    grown = {(x + i, y + j, z + k) for x, y, z in points for i, j, k in steps}
    inside = {p for p in grown if all(0 <= c < side for c, side in zip(p, shape, strict=True))}
    dilated = SparseLattice.from_distinct(tensor(points), shape).dilated(radius)
    assert as_set(dilated) == inside
    assert dilated.shape == shape


@settings(deadline=None, max_examples=40)
@given(SHAPES, st.lists(st.tuples(*3 * [st.integers(-4, 24)]), max_size=60))
def test_a_mask_and_back(shape: Shape, points: list[Point]) -> None:
    """Points outside are left out; numbers run with z fastest, as the spline's rows rely on."""
    inside = {p for p in points if all(0 <= c < side for c, side in zip(p, shape, strict=True))}
    mask = occupied_mask(tensor(points), shape)
    assert mask.shape == shape
    assert [tuple(p) for p in SparseLattice.from_mask(mask).coordinates.tolist()] == sorted(inside)


def test_just_outside_there_is_nothing() -> None:
    lattice = SparseLattice.from_mask(torch.ones(5, 9, 17, dtype=torch.bool))
    for axis, side in enumerate((5, 9, 17)):
        for beyond in (-9, -1, side, side + 8):
            asked = torch.tensor([2, 3, 4])
            asked[axis] = beyond
            assert lattice.find(asked) == -1


def test_a_look_up_keeps_the_shape_of_the_question() -> None:
    lattice = SparseLattice.from_mask(torch.ones(9, 9, 9, dtype=torch.bool))
    asked = torch.randint(0, 9, (4, 5, 3), generator=torch.Generator().manual_seed(0))
    expected = (asked[..., 0] * 9 + asked[..., 1]) * 9 + asked[..., 2]
    assert torch.equal(lattice.find(asked), expected)


def test_memory_follows_the_occupied_blocks() -> None:
    corners = tensor([(0, 0, 0), (499, 499, 499), (499, 499, 498)])
    lattice = SparseLattice.from_distinct(corners, (500, 500, 500))
    assert lattice.leaves.shape == (3, 512)  # the empty leaf and two more


def test_offsets_are_the_27_neighbours_with_z_fastest() -> None:
    expected = list(itertools.product((-1, 0, 1), repeat=3))
    assert [tuple(o) for o in neighbour_offsets().tolist()] == expected
