"""Section III-C as it is written, one equation after the other, differentiated automatically.

Slow, and nothing in udflow computes with it: it is here to be read beside the paper, and for tests
and timings to compare `passes` with.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from udflow.fields.network import Network, Weights
from udflow.fields.outputs import output_factor, output_value


def embed_position(points: Tensor, frequencies: int) -> Tensor:
    """Equation (6), (n, 3 + 6 F)."""
    waves = [points]
    for i in range(frequencies):
        waves += [torch.sin(2**i * math.pi * points), torch.cos(2**i * math.pi * points)]
    return torch.cat(waves, dim=1)


def embed_time(t: Tensor, frequencies: Tensor) -> Tensor:
    """Equation (7) for (n, 1) times, (n, 1 + 2 D)."""
    phase = 2 * math.pi * frequencies * t
    return torch.cat([t, phase.sin(), phase.cos()], dim=1)


def film(t: Tensor, weights: Weights) -> tuple[Tensor, Tensor]:
    """(scale, shift) = MLP(f_time(t)), (n, H + P) each."""
    values = embed_time(t, weights["time.frequencies"])
    for layer in range(3):
        values = values @ weights[f"time{layer}.weight"].T + weights[f"time{layer}.bias"]
        values = values.relu() if layer < 2 else values
    scale, shift = values.chunk(2, dim=1)
    return scale, shift


def distance(network: Network, weights: Weights, points: Tensor, t: Tensor) -> Tensor:
    """d(x, t) for (n, 3) points at (n, 1) times, (n,)."""
    config = network.config
    embedded = embed_position(points, config.position_frequencies)
    hidden = embedded
    scale, shift = film(t, weights) if network.timed else (t, t)
    for layer in range(config.layers):
        matrix, columns = _matrix(network, weights, layer)
        joined = torch.cat([hidden, embedded], dim=1) if layer in config.skips else hidden
        if layer in config.film:
            joined = joined * scale[:, columns] + shift[:, columns]
        hidden = torch.addmm(weights[f"layer{layer}.bias"], joined, matrix.T).relu()
    s = (hidden @ weights["output.weight"].T + weights["output.bias"])[:, 0]
    return output_value(config.output, s * output_factor(config.scale, t[:, 0]))


def velocity(network: Network, weights: Weights, points: Tensor, t: Tensor) -> Tensor:
    """Equation (8), v = d grad d, (n, 3); can be differentiated again by the weights."""
    points = points.detach().requires_grad_()
    d = distance(network, weights, points, t)
    (slope,) = torch.autograd.grad(d.sum(), points, create_graph=True)
    return d[:, None] * slope


def _matrix(network: Network, weights: Weights, layer: int) -> tuple[Tensor, slice]:
    """W_l for the joined input, and the columns of scale and shift that modulate it."""
    width = network.config.width
    if layer == 0:
        return weights["layer0.position"], slice(width, None)
    matrix = weights[f"layer{layer}.weight"]
    if layer not in network.config.skips:
        return matrix, slice(0, width)
    return torch.cat([matrix, weights[f"layer{layer}.position"]], dim=1), slice(None)
