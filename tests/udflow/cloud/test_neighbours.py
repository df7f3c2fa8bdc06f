"""Nearest samples against all distances."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree


def points(count: int, seed: int) -> Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("k", [1, 7])
def test_it_finds_what_brute_force_finds(k: int) -> None:
    samples, queries = points(200, 0), points(50, 1)
    near = NeighbourTree(samples).nearest(queries, k)
    distance, index = torch.cdist(queries, samples).sort(dim=1)
    assert torch.equal(near.index, index[:, :k])
    torch.testing.assert_close(near.distance, distance[:, :k])
    assert near.distance.dtype == torch.float32


def test_a_sample_is_its_own_nearest() -> None:
    samples = points(100, 2)
    near = NeighbourTree(samples).nearest(samples, 2)
    assert torch.equal(near.index[:, 0], torch.arange(100))
    assert not near.distance[:, 0].any()


def test_fewer_samples_than_asked_for() -> None:
    near = NeighbourTree(points(4, 0)).nearest(points(3, 1), 10)
    assert near.index.shape == near.distance.shape == (3, 4)


def test_no_queries() -> None:
    near = NeighbourTree(points(4, 0)).nearest(torch.empty(0, 3), 3)
    assert near.index.shape == (0, 3)


def test_arrays_serve_as_well_as_tensors() -> None:
    samples, queries = points(50, 0), points(20, 1)
    one = NeighbourTree(samples).nearest(queries, 3)
    two = NeighbourTree(samples.numpy().astype(np.float64)).nearest(queries, 3)
    assert torch.equal(one.index, two.index)
