"""Optimisers on one flat tensor, in place and without asking the device for a number."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from udflow.fields.network import Network, Weights
from udflow.neural_config import Optimiser

_MEAN_DECAY, _SQUARE_DECAY, _EPSILON = 0.9, 0.999, 1e-15  # gradients of squared lengths are tiny
_NEGLIGIBLE, _NEGLIGIBLE_SQUARE = 1e-30, 1e-36
_NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)
_NEWTON_SCHULZ_STEPS = 5
_RMS = 0.2  # of an orthogonalised update: about that of Adam's, so that both take one rate


class Adam:
    """Kingma and Ba's Adam; the step size and the bias corrections are tensors on the device, so
    that a recorded step can be replayed.

    Attributes:
        mean, square: running means of the gradient and of its square.
        steps: made so far.
    """

    def __init__(self, parameters: Tensor) -> None:
        self.mean = torch.zeros_like(parameters)
        self.square = torch.zeros_like(parameters)
        self.steps = 0
        self._parameters = parameters
        self._rate = parameters.new_zeros(())
        self._correction = parameters.new_ones(())
        self._begun = parameters.new_ones(())
        self._direction = torch.empty_like(parameters)

    def prepare(self, rate: float) -> None:
        """Sets the learning rate of the next step; from the host, without waiting."""
        self.steps += 1
        begun = 1 - _MEAN_DECAY**self.steps
        self._begun.fill_(begun)
        self._rate.fill_(-rate / begun)
        self._correction.fill_(1 / math.sqrt(1 - _SQUARE_DECAY**self.steps))

    def step(self, gradient: Tensor) -> None:
        """Moves the parameters. Only kernels on the device."""
        self.mean.lerp_(gradient, 1 - _MEAN_DECAY)
        self.square.mul_(_SQUARE_DECAY).addcmul_(gradient, gradient, value=1 - _SQUARE_DECAY)
        torch.sqrt(self.square, out=self._direction)
        self._direction.mul_(self._correction).add_(_EPSILON)
        torch.div(self.mean, self._direction, out=self._direction)
        self._turn(gradient)
        self._parameters.addcmul_(self._direction, self._rate)

    def settle(self) -> None:
        """Zeroes what is left of moments whose gradient has stopped, as that of dead units.

        They would decay into denormal numbers and, rounded up again and again, stay there: every
        later product with them takes many times as long. Call it every few hundred steps.
        """
        self.mean.masked_fill_(self.mean.abs() < _NEGLIGIBLE, 0.0)
        self.square.masked_fill_(self.square < _NEGLIGIBLE_SQUARE, 0.0)

    def _turn(self, gradient: Tensor) -> None:
        """Changes the direction before it is taken. Adam's stays as it is."""


class Muon(Adam):
    """Adam, but the square matrices between hidden layers move along the orthogonal matrix nearest
    to their momentum (Jordan et al. 2024; scale of the update after Liu et al. 2025).

    No direction in such a matrix is then left behind because its gradient is small: a rectified
    network gets out of the flat start of equation (3), where d and grad d are both small.
    """

    def __init__(self, parameters: Tensor, network: Network) -> None:
        super().__init__(parameters)
        self._network = network

    def _turn(self, gradient: Tensor) -> None:
        momentum = self._network.views(torch.lerp(gradient, self.mean, _MEAN_DECAY))
        direction = self._network.views(self._direction)
        names = _between_hidden_layers(direction)
        if not names:
            return
        turned = orthogonalised(torch.stack([momentum[name] for name in names]))
        scale = _RMS * math.sqrt(self._network.config.width) * self._begun
        for name, matrix in zip(names, turned, strict=True):
            torch.mul(matrix, scale, out=direction[name])


def orthogonalised(matrices: Tensor) -> Tensor:
    """(m, h, h) matrices with all singular values moved towards 1 (to 0.7 .. 1.2), by a
    Newton-Schulz iteration of fifth order."""
    a, b, c = _NEWTON_SCHULZ
    # the squares of momenta that fade away are denormal: the largest entry becomes 1 first
    x = matrices / matrices.flatten(1).abs().amax(dim=1).clamp_min(1e-30)[:, None, None]
    x = x / x.flatten(1).norm(dim=1).clamp_min(1e-30)[:, None, None]
    for _ in range(_NEWTON_SCHULZ_STEPS):
        square = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(square, square, square, beta=b, alpha=c), x, beta=a)
    return x


def optimiser_for(kind: Optimiser, parameters: Tensor, network: Network) -> Adam:
    """The optimiser that a configuration asks for."""
    return Muon(parameters, network) if kind == "muon" else Adam(parameters)


def _between_hidden_layers(weights: Weights) -> list[str]:
    return [name for name in weights if name.startswith("layer") and name.endswith(".weight")]
