"""Output activations psi: d = psi(s), and the energy d^2 / 2 whose slope is the velocity.

v = d grad d = e'(s) grad s with e(s) = psi(s)^2 / 2, so that a network only ever gives s and
grad s. For "abs" e'(s) = s: the velocity does not see the fold of |s|, and no state is dead. For
"relu", the paper's, both d and its slope are zero wherever s < 0.
"""

from __future__ import annotations

import torch
from torch import Tensor

from udflow.errors import InvalidConfig
from udflow.neural_config import OUTPUTS, Output, Scale

SHARPNESS = 100.0  # of "softplus": log(1 + exp(100 s)) / 100


def output_value(output: Output, s: Tensor) -> Tensor:
    """d = psi(s).

    Raises:
        InvalidConfig: there is no such activation.
    """
    if output == "abs":
        return s.abs()
    if output == "relu":
        return s.relu()
    if output == "softplus":
        return torch.nn.functional.softplus(s, beta=SHARPNESS)
    raise InvalidConfig(f'network.output is "{output}"; choose one of: {", ".join(OUTPUTS)}')


def energy_slopes(output: Output, s: Tensor) -> tuple[Tensor, Tensor]:
    """e'(s) = psi psi' and e''(s) = psi'^2 + psi psi'', shaped like s.

    Raises:
        InvalidConfig: there is no such activation.
    """
    if output == "abs":
        return s, torch.ones_like(s)
    d = output_value(output, s)
    if output == "relu":
        return d, (s > 0).to(s.dtype)
    first = torch.sigmoid(SHARPNESS * s)
    return d * first, first.square() + d * SHARPNESS * first * (1 - first)


def output_factor(scale: Scale, t: Tensor) -> Tensor:
    """By what s and its slope are multiplied at times t, shaped like t.

    On a straight trajectory x - x_0 = t v*, so that the ideal v* = (x - x_0) / t = d grad d has
    d = dist / sqrt(t): "ideal" leaves only the distance to the network.
    """
    return t.rsqrt() if scale == "ideal" else torch.ones_like(t)
