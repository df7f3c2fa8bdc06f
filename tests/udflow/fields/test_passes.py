"""The gradient by hand against the equations differentiated automatically."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from udflow.config import preset
from udflow.errors import BadField
from udflow.fields import reference
from udflow.fields.embedding import PositionEmbedding
from udflow.fields.network import Network, started
from udflow.fields.outputs import SHARPNESS, energy_slopes, output_factor, output_value
from udflow.fields.passes import Pass, TimedNetwork
from udflow.neural_config import OUTPUTS, STARTS, NetworkConfig

TIMES = (1 / 15, 0.4, 1.0)
NETWORKS = [
    pytest.param(NetworkConfig(layers=6, width=16, skips=(2, 4), film=(0, 2, 3, 4)), id="all"),
    pytest.param(NetworkConfig(layers=4, width=16, skips=(2,), film=()), id="no-time"),
    pytest.param(
        NetworkConfig(layers=3, width=8, skips=(), film=(0,), time_frequencies=0), id="plain-time"
    ),
    pytest.param(
        NetworkConfig(layers=5, width=8, skips=(3,), film=(1, 3), position_frequencies=0), id="raw"
    ),
    pytest.param(
        NetworkConfig(layers=3, width=8, skips=(2,), film=(0, 2), film_width=5), id="narrow-film"
    ),
    pytest.param(NetworkConfig(layers=1, width=8, skips=(), film=(0,)), id="one-layer"),
]


def parameters_of(network: Network, seed: int = 1) -> Tensor:
    """Doubles somewhere away from the start, so that every parameter matters."""
    generator = torch.Generator().manual_seed(seed)
    flat = started(network, generator).double()
    return flat + 0.1 * torch.randn(flat.shape, generator=generator, dtype=torch.float64)


def points_of(count: int, seed: int = 2) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, 3, generator=generator, dtype=torch.float64) - 0.5


@pytest.mark.parametrize("config", NETWORKS)
def test_values_slopes_and_gradients_are_those_of_automatic_differentiation(
    config: NetworkConfig,
) -> None:
    network = Network(config)
    flat, points = parameters_of(network), points_of(30)
    times = torch.tensor(TIMES, dtype=torch.float64)
    column = times.repeat_interleave(10)[:, None]
    generator = torch.Generator().manual_seed(3)
    by_value, by_slope = torch.randn(30, generator=generator).double(), points_of(30, 4)

    room = Pass(network, 30, flat)
    value, slope = room.run(TimedNetwork.at(network, network.views(flat), times), points)
    gradient = torch.full_like(flat, torch.nan)
    room.pull_back(by_value, by_slope, network.views(gradient))

    tracked = flat.clone().requires_grad_()
    x = points.clone().requires_grad_()
    factor = output_factor(config.scale, column[:, 0])
    d = reference.distance(network, network.views(tracked), x, column)
    sign = torch.where(value < 0, -1.0, 1.0)  # the output of these networks is |s|
    s = sign * d / factor
    (expected_slope,) = torch.autograd.grad(s.sum(), x, create_graph=True)
    total = (by_value * s).sum() + (by_slope * expected_slope).sum()
    (expected,) = torch.autograd.grad(total, tracked)

    torch.testing.assert_close(value, s, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(slope, expected_slope, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(
        gradient, expected, rtol=1e-8, atol=1e-8 * float(expected.abs().max())
    )


def test_a_room_is_used_again() -> None:
    network = Network(NetworkConfig(layers=3, width=8, skips=(2,), film=(0,)))
    flat, times = parameters_of(network), torch.tensor([0.5], dtype=torch.float64)
    timed = TimedNetwork.at(network, network.views(flat), times)
    room = Pass(network, 7, flat)
    first = [part.clone() for part in room.run(timed, points_of(7))]
    room.run(timed, points_of(7, 9))
    again = room.run(timed, points_of(7))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_parameters_of_the_paper_are_counted() -> None:
    """12 layers of 256, 33 embedded coordinates, skips at 4 and 8; Table VII says 1.0 M."""
    network = Network(preset("paper").network)
    backbone = 33 * 256 + 11 * 256**2 + 2 * 33 * 256 + 12 * 256 + 257
    time = 16 + (33 * 256 + 256) + (256**2 + 256) + (256 * 578 + 578)
    assert network.size == backbone + time == 972_627
    assert network.embedded == 33
    assert round(network.size / 1e6, 1) == 1.0


class Products(TorchDispatchMode):
    """Counts the floating-point operations of the matrix products that are really made."""

    made = 0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        name = func.overloadpacket.__name__
        if name in ("mm", "bmm", "addmm", "addmm_", "baddbmm", "baddbmm_"):
            left, right = args[-2:]
            self.made += 2 * left.numel() * right.shape[-1]
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("film", [(), (0, 2)])
def test_an_iteration_makes_the_products_that_are_counted(film: tuple[int, ...]) -> None:
    """Four a matrix by hand, half of them for values and slopes; six by automatic double
    differentiation of the same network. Folding the times in and the last row cost next to none."""
    network = Network(NetworkConfig(layers=6, width=64, skips=(2, 4), film=film))
    flat, times = started(network, torch.Generator().manual_seed(0)), torch.tensor([0.2, 0.5, 1.0])
    points, by_value, by_slope = points_of(3_000).float(), torch.ones(3_000), points_of(3_000, 5)
    room = Pass(network, 3_000, flat)
    with Products() as there:
        room.run(TimedNetwork.at(network, network.views(flat), times), points)
    with Products() as back:
        room.pull_back(by_value, by_slope.float(), network.views(torch.empty_like(flat)))
    assert there.made == pytest.approx(network.flops(3_000, passes=2), rel=0.02)
    assert there.made + back.made == pytest.approx(network.flops(3_000), rel=0.02)

    tracked, t = flat.clone().requires_grad_(), times.repeat_interleave(1_000)[:, None]
    with Products() as automatic:
        velocity = reference.velocity(network, network.views(tracked), points, t)
        torch.autograd.grad(velocity.square().sum(), tracked)
    assert automatic.made > 0.9 * network.flops(3_000, passes=6)


def test_operations_of_the_paper_are_counted() -> None:
    """Six products per matrix and point for automatic double differentiation. Table VII says
    59.3 G; with the time network counted for every point, as a counter that knows no better does,
    5 000 points make 58 G."""
    network = Network(preset("paper").network)
    assert network.products == 33 * 256 + 11 * 256**2 + 2 * 33 * 256 + 256 == 746_496
    assert network.flops(5_000) == 8 * 5_000 * 746_496
    time_network = 33 * 256 + 256**2 + 256 * 578
    assert 12 * 5_000 * (network.products + time_network) == pytest.approx(59.3e9, rel=0.03)


def test_every_shape_of_the_paper() -> None:
    shapes = Network(preset("paper").network).shapes
    for layer in range(12):
        assert shapes[f"layer{layer}.bias"] == (256,)
        assert shapes.get(f"layer{layer}.weight") == ((256, 256) if layer else None)
        assert shapes.get(f"layer{layer}.position") == ((256, 33) if layer in (0, 4, 8) else None)
    assert shapes["output.weight"] == (1, 256)
    assert shapes["output.bias"] == (1,)
    assert shapes["time.frequencies"] == (16,)
    assert shapes["time0.weight"] == (256, 33)
    assert shapes["time1.weight"] == (256, 256)
    assert shapes["time2.weight"] == (2 * (256 + 33), 256)
    assert len(shapes) == 12 + 11 + 3 + 2 + 7


def test_the_position_embedding_is_equation_six() -> None:
    points = points_of(5)
    embedded = PositionEmbedding.of(points, 5)
    torch.testing.assert_close(embedded.values, reference.embed_position(points, 5))
    assert embedded.values.shape == (5, 33)


def test_parameters_of_another_network_are_refused() -> None:
    network = Network(NetworkConfig())
    with pytest.raises(BadField, match="configuration it was made with"):
        network.views(torch.zeros(network.size + 1))


@pytest.mark.parametrize("output", OUTPUTS)
def test_slopes_of_the_energy(output: str) -> None:
    s = torch.tensor([-0.3, -0.01, 0.004, 0.2], dtype=torch.float64, requires_grad=True)
    energy = 0.5 * output_value(output, s).square()  # type: ignore[arg-type]
    (first,) = torch.autograd.grad(energy.sum(), s, create_graph=True)
    second = torch.autograd.grad(first.sum(), s, allow_unused=True)[0]
    found = energy_slopes(output, s.detach())  # type: ignore[arg-type]
    torch.testing.assert_close(found[0], first.detach())
    assert second is not None
    torch.testing.assert_close(found[1], second)


def test_outputs_are_what_they_are_called() -> None:
    s = torch.tensor([-2.0, 0.0, 3.0])
    assert output_value("abs", s).tolist() == [2.0, 0.0, 3.0]
    assert output_value("relu", s).tolist() == [0.0, 0.0, 3.0]
    assert float(output_value("softplus", s)[1]) == pytest.approx(0.6931 / SHARPNESS, rel=1e-3)


@pytest.mark.parametrize("start", STARTS)
def test_starts_depend_on_their_seed_alone_and_are_alive(start: str) -> None:
    network = Network(NetworkConfig(start=start))  # type: ignore[arg-type]
    first, same, other = (
        started(network, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first, same)
    assert not torch.equal(first, other)
    times = torch.tensor([1 / 15, 1.0])
    timed = TimedNetwork.at(network, network.views(first), times)
    value, slope = Pass(network, 400, first).run(timed, points_of(400).float())
    assert bool(torch.isfinite(value).all())
    assert float((slope.norm(dim=1) > 1e-4).float().mean()) > 0.99


def test_the_sphere_start_is_a_faint_distance_from_a_sphere() -> None:
    network = Network(NetworkConfig(start="sphere", film=(), width=256))
    flat = started(network, torch.Generator().manual_seed(0))
    timed = TimedNetwork.at(network, network.views(flat), torch.ones(1))
    points = points_of(500).float()
    value, slope = Pass(network, 500, flat).run(timed, points)
    outward = (slope * torch.nn.functional.normalize(points, dim=1)).sum(dim=1)
    assert float(outward.mean()) == pytest.approx(0.05, abs=0.0125)
    assert float(torch.corrcoef(torch.stack([value, points.norm(dim=1)]))[0, 1]) > 0.9
