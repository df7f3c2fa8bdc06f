"""The compiled loop gives the feet that the tensor code gives."""

from __future__ import annotations

import pytest
import torch
from shapes import Sphere, TwoSheets
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface


def wedge(angle: float, count: int = 6000) -> Tensor:
    """Samples of two half planes that meet along the y axis at an angle."""
    plane = torch.rand(count, 2, generator=torch.Generator().manual_seed(1))
    across, along = 0.5 * plane[:, 0], plane[:, 1] - 0.5
    one, two = across.clone(), torch.zeros_like(across)
    second = torch.arange(count) >= count // 2
    one[second], two[second] = (
        across[second] * torch.cos(torch.tensor(angle)),
        across[second] * torch.sin(torch.tensor(angle)),
    )
    return torch.stack([one, along, two], dim=1)


SAMPLES = {
    "smooth": Sphere().sample(4000),
    "sheets": TwoSheets().sample(4000),
    "right angle": wedge(1.57),
    "sharp": wedge(0.5),
    "blunt": wedge(2.4),
    "noisy": wedge(1.57) + 0.004 * torch.randn(6000, 3, generator=torch.Generator().manual_seed(2)),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_feet_are_those_of_the_tensor_code(name: str) -> None:
    samples = SAMPLES[name]
    surface = SampledSurface.of(samples).surface
    generator = torch.Generator().manual_seed(3)
    near = samples + 0.02 * torch.randn(samples.shape, generator=generator)
    far = 3 * torch.rand(500, 3, generator=generator) - 1.5
    queries = torch.cat([near, far])
    found = surface.tree.nearest(queries, 6)
    by_loop, by_tensors = surface.by_loop(queries, found), surface.by_tensors(queries, found)
    difference = (by_loop - by_tensors).norm(dim=1)
    # at a tie between two feet either may win
    assert float(difference.quantile(0.998)) < 2e-5
    length = (by_loop - queries).norm(dim=1) - (by_tensors - queries).norm(dim=1)
    assert float(length.abs().quantile(0.998)) < 2e-5


def test_creases_are_among_what_was_compared() -> None:
    """Without its crease the wedge would be rounded."""
    surface = SampledSurface.of(SAMPLES["right angle"]).surface
    queries = torch.tensor([[-0.005, 0.1, -0.005], [-0.003, 0.0, -0.008]])
    feet = surface.by_loop(queries, surface.tree.nearest(queries, 6))
    expected = torch.tensor([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    torch.testing.assert_close(feet, expected, rtol=0, atol=4e-4)
