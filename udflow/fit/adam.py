"""Adam on one flat tensor, in place and without asking the device for a number."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_MEAN_DECAY, _SQUARE_DECAY, _EPSILON = 0.9, 0.999, 1e-15


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
        self._spare = torch.empty_like(parameters)

    def prepare(self, rate: float) -> None:
        """Sets the learning rate of the next step; from the host, without waiting."""
        self.steps += 1
        self._rate.fill_(-rate / (1 - _MEAN_DECAY**self.steps))
        self._correction.fill_(1 / math.sqrt(1 - _SQUARE_DECAY**self.steps))

    def step(self, gradient: Tensor) -> None:
        """Moves the parameters. Only kernels on the device."""
        self.mean.lerp_(gradient, 1 - _MEAN_DECAY)
        self.square.mul_(_SQUARE_DECAY).addcmul_(gradient, gradient, value=1 - _SQUARE_DECAY)
        torch.sqrt(self.square, out=self._spare)
        self._spare.mul_(self._correction).add_(_EPSILON)
        torch.div(self.mean, self._spare, out=self._spare)
        self._parameters.addcmul_(self._spare, self._rate)
