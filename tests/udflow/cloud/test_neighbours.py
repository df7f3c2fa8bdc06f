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


def brute(samples: Tensor, queries: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Distances and indices, of equally near samples the first first."""
    square = (samples[None] - queries[:, None]).square()
    square = square[..., 0] + square[..., 1] + square[..., 2]
    index = square.sort(dim=1, stable=True).indices[:, :k]
    return square.gather(1, index).sqrt(), index


@pytest.mark.parametrize("k", [1, 6, 17, 96, 1500])
@pytest.mark.parametrize("kind", ["surface", "uneven", "lattice", "copies", "line", "far off"])
def test_it_finds_the_very_same_on_every_kind_of_cloud(kind: str, k: int) -> None:
    samples = points(1500, 3)
    if kind == "surface":
        samples[:, 2] = 0.3 * samples[:, 0] ** 2
    elif kind == "uneven":
        samples = samples**8
    elif kind == "lattice":
        samples = torch.round(9 * samples)
    elif kind == "copies":
        samples = samples[torch.arange(1500) % 7]
    elif kind == "line":
        samples[:, 1:] = 0
    else:
        samples[0] = 1e4
    queries = torch.cat([samples[::10], 3 * points(50, 4) - 1, torch.full((1, 3), 1e4)])
    near = NeighbourTree(samples).nearest(queries, k)
    distance, index = brute(samples, queries, k)
    torch.testing.assert_close(near.distance, distance, rtol=1e-6, atol=0)
    assert float((near.index == index).float().mean()) > 0.999


def test_any_number_of_threads_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    samples, found = torch.round(30 * points(5000, 5)), []
    for count in (1, 2, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda count=count: count)
        found.append(NeighbourTree(samples).nearest(samples, 20))
    for other in found[1:]:
        assert torch.equal(found[0].index, other.index)
        assert torch.equal(found[0].distance, other.distance)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_no_place_is_refused(bad: float) -> None:
    spoilt = points(20, 6)
    spoilt[3, 1] = bad
    with pytest.raises(ValueError, match="not a finite number"):
        NeighbourTree(spoilt)
    with pytest.raises(ValueError, match="not a finite number"):
        NeighbourTree(points(20, 6)).nearest(spoilt, 2)
