"""The compiled fits, means and pieces are those of the tensor code."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import pytest
import torch
from shapes import Sphere, Torus, TwoSheets
from torch import Tensor

from udflow.cloud import fits, pieces, sites, widths
from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadrics import LocalQuadrics, heights_over
from udflow.cloud.sampled_surface import SampledSurface
from udflow.cloud.sites import Sites
from udflow.cloud.widths import fit_quadrics


def noise(samples: Tensor, sigma: float) -> Tensor:
    return samples + sigma * torch.randn(samples.shape, generator=torch.Generator().manual_seed(2))


def box(count: int) -> Tensor:
    """Samples of the faces of a cube."""
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    row = torch.arange(count)
    points[row, row % 3] = 0.5 * (-1.0) ** (row // 3)
    return points


SAMPLES = {
    "smooth": Torus().sample(3000),
    "noisy": noise(Sphere().sample(3000), 0.003),
    "sheets": TwoSheets(gap=0.05).sample(3000),
    "creased": box(3000),
    "creased and noisy": noise(box(3000), 0.002),
}
Case = pytest.mark.parametrize("name", SAMPLES)


def around(samples: Tensor) -> Sites:
    return Sites(samples, samples, NeighbourTree(samples))


@cache
def fitted(name: str) -> LocalQuadrics:
    return fit_quadrics(around(SAMPLES[name]))


def differences(one: LocalQuadrics, two: LocalQuadrics, near: Tensor) -> Tensor:
    """(n,) how far two surfaces are apart over (n, k, 3) points near their sites, in radii."""
    heights = [q.frame[:, 2, None] * heights_over(q, near)[..., None] for q in (one, two)]
    return (heights[0] - heights[1]).norm(dim=2).amax(dim=1) / one.radius


@Case
@pytest.mark.parametrize("k", [10, 40, 144])
def test_fits_are_those_of_the_tensor_code(name: str, k: int) -> None:
    samples = SAMPLES[name]
    near = NeighbourTree(samples).nearest(samples, 144)
    rows = torch.arange(0, len(samples), 2)
    origin = samples[rows]
    one, two = (by(samples, origin, near, k, rows) for by in (fits.by_loop, fits.by_tensors))
    apart = differences(one.quadrics, two.quadrics, samples[near.index[rows, :10]])
    # where two principal axes are equally long, frames are a matter of rounding
    assert float(apart.quantile(0.99)) < 1e-4
    radius = two.quadrics.radius
    for name in ("radius", "spacing", "count"):
        torch.testing.assert_close(getattr(one.quadrics, name), getattr(two.quadrics, name))
    for mine, other in (
        ((one.quadrics.error / radius), (two.quadrics.error / radius)),
        (one.variance, two.variance),
        ((one.foot - two.foot).norm(dim=1) / radius, torch.zeros(len(rows))),
    ):
        assert float((mine - other).abs().quantile(0.99)) < 2e-4


def test_frames_are_turned_rightly_even_where_samples_lie_in_a_line() -> None:
    line = torch.linspace(-0.5, 0.5, 100)[:, None] * torch.tensor([0.6, 0.0, 0.8])
    frame = around(line).narrow.quadrics.frame
    identity = frame @ frame.transpose(1, 2)
    torch.testing.assert_close(identity, torch.eye(3).expand_as(frame), rtol=0, atol=1e-6)
    along = (frame[:, 0] @ torch.tensor([0.6, 0.0, 0.8])).abs()
    torch.testing.assert_close(along, torch.ones(100))


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.25, 0.9, 1.0])
@pytest.mark.parametrize("k", [1, 2, 31])
def test_means_and_quantiles_are_those_of_the_tensor_code(share: float, k: int) -> None:
    generator = torch.Generator().manual_seed(3)
    values = torch.rand(500, generator=generator)
    index = torch.randint(0, 500, (500, 40), generator=generator)
    rows = torch.randperm(500, generator=generator)[:200]
    one = sites.sum_up_by_loop(values, rows, index, k, share)
    torch.testing.assert_close(one, sites.sum_up_by_tensors(values, rows, index, k, share))


@Case
def test_pieces_are_those_of_the_tensor_code(name: str) -> None:
    where, quadrics = around(SAMPLES[name]), fitted(name)
    tolerance = (2 * quadrics.error).clamp_min(1e-4)
    every = torch.arange(len(tolerance))
    rounds = [by(quadrics, where, tolerance, every) for by in (pieces.by_loop, pieces.by_tensors)]
    doubtful = [torch.isin(every, found) for _, found in rounds]
    assert float((doubtful[0] != doubtful[1]).float().mean()) < 0.002
    (one, _), (two, _) = rounds
    apart = differences(one, two, where.samples[where.near.index[:, :10]])
    assert float((apart < 1e-4).float().mean()) > 0.99
    assert float((one.count == two.count).float().mean()) > 0.99
    if name.startswith("creased"):
        assert float((one.count != quadrics.count).float().mean()) > 0.05


@pytest.mark.parametrize("name", ["smooth", "noisy", "creased"])
def test_any_number_of_threads_gives_the_same_bytes(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for count in (1, 2, 3):
        monkeypatch.setattr(torch, "get_num_threads", _constant(count))
        found.append(SampledSurface.of(SAMPLES[name]).surface.quadrics)
    for other in found[1:]:
        for field in dataclasses.fields(LocalQuadrics):
            assert torch.equal(getattr(found[0], field.name), getattr(other, field.name))


def _constant(count: int) -> Callable[[], int]:
    return lambda: count


def test_what_lies_near_is_looked_up_once() -> None:
    samples = SAMPLES["smooth"]
    where = around(samples)
    assert where.around(50) is where.around(20)
    assert where.near.index is where.around(40)
    apart = Sites(samples[::2].contiguous(), samples, NeighbourTree(samples))
    assert apart.near.index.shape == (1500, 40)
    assert int(apart.near.index.max()) > 1500 > int(apart.around(40).max())


def test_neighbours_that_are_kept_are_those_that_are_looked_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    samples = SAMPLES["noisy"]
    found = []
    for kept in (1 << 15, 1500, 0):
        monkeypatch.setattr(widths, "_KEPT", kept)
        found.append(
            fit_quadrics(Sites(samples[::2].contiguous(), samples, NeighbourTree(samples)))
        )
    assert found[0].count.unique().tolist()[-1] > 64
    for other in found[1:]:
        for field in dataclasses.fields(LocalQuadrics):
            assert torch.equal(getattr(found[0], field.name), getattr(other, field.name))
