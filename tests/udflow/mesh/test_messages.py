"""Message passing by loops and by tensors is one and the same."""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.mesh.lattice import encode
from udflow.mesh.messages import ByLoops, ByTensors, Passing, Patch, passing


def scattered(count: int = 12_000) -> tuple[Patch, Tensor]:
    """Vertices at random, so that many faces lack some, and evidence for their edges."""
    generator = torch.Generator().manual_seed(0)
    places = torch.unique(torch.randint(1, 30, (count, 3), generator=generator), dim=0)
    patch = Patch.of(torch.sort(encode(places)).values)
    evidence = torch.randn(patch.count + 1, 3, generator=generator)
    evidence[-1] = 30.0
    return patch, evidence


def rounds(state: Passing, count: int) -> list[int]:
    return [state.round() for _ in range(count)]


def test_loops_and_tensors_agree() -> None:
    patch, evidence = scattered()
    states = [
        by(patch, evidence, torch.zeros(patch.count + 1, 3, 4)) for by in (ByLoops, ByTensors)
    ]
    odd = [rounds(state, 20) for state in states]
    assert odd[0] == odd[1]
    assert odd[0][-1] < odd[0][0] / 10
    for name in ("belief", "messages"):
        one, two = (getattr(state, name) for state in states)
        torch.testing.assert_close(one, two, rtol=1e-5, atol=1e-5)


def test_the_device_chooses() -> None:
    patch, evidence = scattered(100)
    messages = torch.zeros(patch.count + 1, 3, 4)
    assert isinstance(passing(patch, evidence, messages), ByLoops)
    away = [x.to("meta") for x in (patch.ahead, patch.behind, evidence, messages)]
    there = passing(Patch(patch.count, *away[:2]), *away[2:])
    assert isinstance(there, ByTensors)
