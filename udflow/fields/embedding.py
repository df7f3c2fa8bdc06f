"""Embeddings of position and time, equations (6) and (7), and what their derivatives need."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.fields.network import Network, Weights


@dataclass(frozen=True)
class PositionEmbedding:
    """Equation (6) at some points: [x, sin(2^0 pi x), cos(2^0 pi x), ...].

    Attributes:
        values: (n, 3 + 6 F).
        slopes: (n, 2 F, 3) derivative of every wave by its own coordinate.
    """

    values: Tensor
    slopes: Tensor

    @classmethod
    def of(cls, points: Tensor, frequencies: int) -> PositionEmbedding:
        """The embedding of (n, 3) points with F frequencies."""
        powers = torch.arange(frequencies, device=points.device, dtype=points.dtype)
        octaves = math.pi * torch.exp2(powers)
        angles = octaves[:, None] * points[:, None, :]
        sine, cosine = angles.sin(), angles.cos()
        waves = torch.stack([sine, cosine], dim=2)
        slopes = torch.stack([cosine, -sine], dim=2) * octaves[:, None, None]
        values = torch.cat([points, waves.flatten(1)], dim=1)
        return cls(values, slopes.flatten(1, 2))

    def tangent(self, direction: Tensor) -> Tensor:
        """Change of the values for (n, 3) directions of x, (n, 3 + 6 F)."""
        return torch.cat([direction, (self.slopes * direction[:, None]).flatten(1)], dim=1)

    def gradient(self, adjoint: Tensor) -> Tensor:
        """Gradient by x, (n, 3), from the gradient by the values, (n, 3 + 6 F)."""
        waves = adjoint[:, 3:].unflatten(1, self.slopes.shape[1:])
        return adjoint[:, :3] + (self.slopes * waves).sum(dim=1)


@dataclass(frozen=True)
class Modulation:
    """(scale, shift) = MLP(f_time(t)) for some times, with what the way back needs.

    Attributes:
        scale, shift: (T, H + P): columns for h_l, then for h_0.
        phases: (T, D) 2 pi w t.
        layers: values before each of the three matrices of the MLP.
    """

    times: Tensor
    scale: Tensor
    shift: Tensor
    phases: Tensor
    layers: tuple[Tensor, Tensor, Tensor]

    @classmethod
    def of(cls, weights: Weights, times: Tensor) -> Modulation:
        """For (T,) times."""
        phases = 2 * math.pi * times[:, None] * weights["time.frequencies"]
        embedded = torch.cat([times[:, None], phases.sin(), phases.cos()], dim=1)
        first = (embedded @ weights["time0.weight"].T + weights["time0.bias"]).relu()
        second = (first @ weights["time1.weight"].T + weights["time1.bias"]).relu()
        both = second @ weights["time2.weight"].T + weights["time2.bias"]
        scale, shift = both.chunk(2, dim=1)
        return cls(times, scale, shift, phases, (embedded, first, second))

    def pull_back(
        self, scale_gradient: Tensor, shift_gradient: Tensor, weights: Weights, gradients: Weights
    ) -> None:
        """Writes the gradients of the time parameters, from those of scale and shift."""
        adjoint = torch.cat([scale_gradient, shift_gradient], dim=1)
        for number in (2, 1, 0):
            values = self.layers[number]
            torch.mm(adjoint.T, values, out=gradients[f"time{number}.weight"])
            torch.sum(adjoint, dim=0, out=gradients[f"time{number}.bias"])
            adjoint = adjoint @ weights[f"time{number}.weight"]
            if number > 0:
                adjoint = adjoint * (values > 0)
        by_sine, by_cosine = adjoint[:, 1:].chunk(2, dim=1)
        by_phase = by_sine * self.phases.cos() - by_cosine * self.phases.sin()
        by_frequency = 2 * math.pi * (self.times[:, None] * by_phase).sum(dim=0)
        gradients["time.frequencies"].copy_(by_frequency)


def modulation(network: Network, weights: Weights, times: Tensor) -> Modulation | None:
    """The modulation of a network, None where it does not depend on the time."""
    return Modulation.of(weights, times) if network.timed else None
