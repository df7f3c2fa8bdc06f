"""Sheets no farther apart than their samples are told apart by the planes that samples share."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from udflow.cloud import consensus
from udflow.cloud.consensus import SHEETS, on_shared_planes
from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.quadrics import LocalQuadrics, heights_over, normals_at
from udflow.cloud.sampled_surface import SampledSurface
from udflow.cloud.sites import Sites
from udflow.cloud.widths import fit_quadrics

COUNT = 4000
SPACING = (2 / COUNT) ** 0.5  # of both sheets of the plate taken together


def uniform(count: int, seed: int) -> Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) - 0.5


def plate(gap: float, sigma: float = 0.0) -> Tensor:
    """Samples of two parallel sheets, aslant so that no axis is special."""
    points = uniform(COUNT, 1)
    points[:, 2] = gap * (torch.arange(COUNT) % 2 - 0.5)
    points = points + sigma * torch.randn(points.shape, generator=torch.Generator().manual_seed(2))
    return points @ turned().T


def turned() -> Tensor:
    """A rotation."""
    return torch.linalg.qr(uniform(3, 5)).Q


def around(samples: Tensor) -> Sites:
    return Sites(samples, samples, NeighbourTree(samples))


def inside(samples: Tensor) -> Tensor:
    """Which samples of the plate are away from its rims."""
    return ((samples @ turned()).abs() < 0.4)[:, :2].all(dim=1)


def missed(quadrics: LocalQuadrics, samples: Tensor, gap: float) -> float:
    """Share of the sites, away from the rims, whose quadrics miss them or lie aslant."""
    off = heights_over(quadrics, samples[:, None])[:, 0].abs() > 0.1 * gap
    normals = normals_at(quadrics, samples)
    sine = torch.linalg.cross(normals, turned()[:, 2].expand_as(normals)).norm(dim=1)
    return float((off | (sine > 0.25))[inside(samples)].float().mean())


@pytest.mark.parametrize("gap", [0.7, 1.0, 1.5])
def test_a_plate_as_thin_as_its_samples_are_apart_has_two_sheets(gap: float) -> None:
    samples = plate(gap * SPACING)
    where = around(samples)
    before = fit_quadrics(where)
    after, shared = on_shared_planes(before, where)
    assert missed(before, samples, gap * SPACING) > 0.3
    assert missed(after, samples, gap * SPACING) < 0.02
    assert float(shared.float().mean()) > 0.5


def test_feet_lie_on_the_sheets_of_such_a_plate() -> None:
    gap = SPACING
    surface = SampledSurface.of(plate(gap))
    queries = plate(gap, 0.2 * gap)
    feet = (surface.project(queries[inside(queries)]) @ turned())[:, 2]
    assert float((feet.abs() - 0.5 * gap).abs().mean()) < 0.02 * gap


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_under_noise_nothing_is_shared(sigma: float) -> None:
    samples = plate(20 * SPACING, sigma * SPACING)
    where = around(samples)
    before = fit_quadrics(where)
    after, shared = on_shared_planes(before, where)
    assert float(shared.float().mean()) < 0.03
    assert torch.equal(after.frame[~shared], before.frame[~shared])


def test_a_scan_line_is_no_plane() -> None:
    lines = uniform(3000, 3) * torch.tensor([1.0, 0.0, 0.0])
    lines[:, 1] = 0.05 * (torch.arange(3000) % 20)
    lines[:, 2] = 0.3 * (lines[:, 0] * 9).sin() * lines[:, 1]
    where = around(lines)
    assert not on_shared_planes(fit_quadrics(where), where)[1].any()


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.3])
def test_loops_find_what_the_tensor_code_finds(sigma: float) -> None:
    samples = plate(SPACING, sigma * SPACING)
    where = around(samples)
    quadrics = fit_quadrics(where)
    tolerance = SHEETS.tolerance * quadrics.spacing
    one = consensus.by_loop(quadrics, samples, where.near, SHEETS)
    two = consensus.by_tensors(quadrics, samples, where.near, SHEETS)
    assert float((one.agreed != two.agreed).float().mean()) < 0.003
    assert float((one.better != two.better).float().mean()) < 0.003
    both = one.agreed & two.agreed
    assert float((one.piece[both] != two.piece[both]).float().mean()) < 0.003
    assert float(((one.error - two.error)[both].abs() / tolerance[both]).quantile(0.99)) < 1e-3
    assert float(both.float().mean()) > (0.2 if sigma == 0 else 0.0)


def test_a_handful_of_samples_shares_nothing() -> None:
    samples = uniform(5, 4)
    where = around(samples)
    assert not on_shared_planes(fit_quadrics(where), where)[1].any()
