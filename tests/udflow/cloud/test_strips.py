"""Strips narrower than their samples are apart get planes of their own."""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.cloud import consensus, strips
from udflow.cloud.neighbours import NeighbourTree
from udflow.cloud.pieces import on_one_piece
from udflow.cloud.quadrics import LocalQuadrics, heights_over, moved, normals_at
from udflow.cloud.sampled_surface import SampledSurface
from udflow.cloud.sites import Sites
from udflow.cloud.strips import on_strips
from udflow.cloud.widths import fit_quadrics

COUNT = 6000
SPACING = (1 / COUNT) ** 0.5
HEIGHT = 0.7 * SPACING  # of the step


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def turned() -> Tensor:
    """A rotation, so that no axis is special."""
    return torch.linalg.qr(torch.rand(3, 3, generator=seeded(5)) - 0.5).Q


def step(sigma: float = 0.0) -> tuple[Tensor, Tensor]:
    """Samples of two floors and the step between them, as many by area; which are on the step."""
    points = torch.rand(COUNT, 3, generator=seeded(1)) - 0.5
    points[:, 2] = torch.where(points[:, 0] > 0, HEIGHT, 0.0)
    riser = torch.rand(round(HEIGHT * COUNT), 3, generator=seeded(2))
    riser = torch.stack([0 * riser[:, 0], riser[:, 1] - 0.5, HEIGHT * riser[:, 2]], dim=1)
    samples = torch.cat([points, riser])
    samples = samples + sigma * torch.randn(samples.shape, generator=seeded(3))
    return samples @ turned().T, torch.arange(len(samples)) >= COUNT


def around(samples: Tensor) -> Sites:
    return Sites(samples, samples, NeighbourTree(samples))


def upright(quadrics: LocalQuadrics, on_riser: Tensor) -> float:
    """Share of the step's sites whose quadrics stand upright, away from its ends."""
    inner = on_riser & ((quadrics.origin @ turned())[:, 1].abs() < 0.4)
    normals = normals_at(quadrics, quadrics.origin)[inner]
    return float(((normals @ turned())[:, 0].abs() > 0.98).float().mean())


def test_a_step_lower_than_its_samples_are_apart_stands_upright() -> None:
    samples, on_riser = step()
    sites = around(samples)
    quadrics = fit_quadrics(sites)
    assert upright(quadrics, on_riser) < 0.1
    assert upright(on_one_piece(quadrics, sites), on_riser) > 0.4


def test_feet_near_such_a_step_lie_on_it() -> None:
    samples, _ = step()
    queries = torch.rand(500, 3, generator=seeded(4)) - 0.5
    queries[:, 0] *= 0.2 * HEIGHT
    queries[:, 1] *= 0.8
    queries[:, 2] = 0.5 * HEIGHT + 0.5 * HEIGHT * queries[:, 2]
    feet = SampledSurface.of(samples).project(queries @ turned().T) @ turned()
    assert float(feet[:, 0].abs().mean()) < 0.04 * HEIGHT  # 0.055 without strips


def test_exact_planes_are_the_same_by_loop_and_by_tensors() -> None:
    samples, _ = step()
    sites = around(samples)
    quadrics, asked = fit_quadrics(sites), strips._EXACT
    near = sites.tree.nearest(samples, asked.pool)
    one = consensus.by_loop(quadrics, samples, near, asked)
    two = consensus.by_tensors(quadrics, samples, near, asked)
    assert float((one.better != two.better).float().mean()) < 0.01
    both = one.agreed & two.agreed
    assert float((one.piece[both] != two.piece[both]).float().mean()) < 0.003


def test_noisy_quadrics_stay() -> None:
    samples, _ = step(0.2 * SPACING)
    sites = around(samples)
    quadrics = fit_quadrics(sites)
    tolerance = torch.full((len(samples),), 0.8 * SPACING)
    kept = on_strips(quadrics, sites, tolerance, torch.arange(len(samples)))
    changed = (kept.coefficients != quadrics.coefficients).any(dim=1)
    assert float(changed.float().mean()) < 0.001


def test_a_moved_quadric_is_the_same_surface() -> None:
    samples, _ = step(0.1 * SPACING)
    quadrics = fit_quadrics(around(samples))
    offset = SPACING * torch.rand(len(samples), 3, generator=seeded(6))
    points = samples[:, None] + SPACING * torch.rand(len(samples), 5, 3, generator=seeded(7))
    before = heights_over(quadrics, points)
    after = heights_over(moved(quadrics, quadrics.origin + offset), points)
    torch.testing.assert_close(after, before, rtol=1e-3, atol=1e-3 * SPACING)
