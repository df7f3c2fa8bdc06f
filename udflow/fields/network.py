"""The network of section III-C as a list of matrices: names, shapes, counts, first values.

All parameters live in one flat tensor, so that an optimiser, a checkpoint or a cast to another
precision is a single operation; names are views of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from udflow.errors import BadField
from udflow.neural_config import NetworkConfig

_FAINT = 0.05  # of the distance from the sphere at the start "sphere"
_SMALL = 0.1  # of the output's weights at the start "he"
_ALIVE = 0.05  # the output at the start of a rectified d: below zero nothing would ever move it
SPHERE_RADIUS = 0.25  # of the start "sphere"
Weights = dict[str, Tensor]


@dataclass(frozen=True)
class Network:
    """Shapes of a network's parameters.

    With P = 3 + 6 F embedded coordinates, layer l computes z = W_l S_l(h_l) + b_l, where S_l joins
    the embedded position h_0 in layer 0 and in the skip layers. The matrix of the joined part is
    kept by itself: `layer{l}.weight` (H, H) acts on h_l and `layer{l}.position` (H, P) on h_0,
    which is the same sum without a copy.

    Attributes:
        config: the architecture.
    """

    config: NetworkConfig

    @property
    def embedded(self) -> int:
        """P, the width of the embedded position."""
        return 3 + 6 * self.config.position_frequencies

    @property
    def timed(self) -> bool:
        """Whether the field depends on the time."""
        return len(self.config.film) > 0

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every parameter, in the order of the flat tensor."""
        config, width = self.config, self.config.width
        shapes: dict[str, tuple[int, ...]] = {}
        for layer in range(config.layers):
            if layer > 0:
                shapes[f"layer{layer}.weight"] = (width, width)
            if layer == 0 or layer in config.skips:
                shapes[f"layer{layer}.position"] = (width, self.embedded)
            shapes[f"layer{layer}.bias"] = (width,)
        shapes["output.weight"] = (1, width)
        shapes["output.bias"] = (1,)
        return shapes | (self._time_shapes() if self.timed else {})

    def _time_shapes(self) -> dict[str, tuple[int, ...]]:
        """The time embedding and its MLP with two hidden layers: (scale, shift) for the columns of
        h_l and then for those of h_0, shared by all layers."""
        modulated = self.config.width + self.embedded
        width = self.config.film_width or self.config.width
        return {
            "time.frequencies": (self.config.time_frequencies,),
            "time0.weight": (width, 1 + 2 * self.config.time_frequencies),
            "time0.bias": (width,),
            "time1.weight": (width, width),
            "time1.bias": (width,),
            "time2.weight": (2 * modulated, width),
            "time2.bias": (2 * modulated,),
        }

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(math.prod(shape) for shape in self.shapes.values())

    def views(self, flat: Tensor) -> Weights:
        """The parameters by name, as views of the flat (size,) tensor.

        Raises:
            BadField: the tensor has another number of parameters.
        """
        if flat.shape != (self.size,):
            raise BadField(
                f"the network has {self.size} parameters, the tensor {tuple(flat.shape)}; "
                "load it with the configuration it was made with"
            )
        views, offset = {}, 0
        for name, shape in self.shapes.items():
            count = math.prod(shape)
            views[name] = flat[offset : offset + count].view(shape)
            offset += count
        return views

    @property
    def products(self) -> int:
        """Multiplications of one point on its way through the network once."""
        return sum(math.prod(self.shapes[name]) for name in self.shapes if _per_point(name))

    def flops(self, points: int, passes: int = 4) -> int:
        """Floating-point operations of matrix products.

        Args:
            points: in the batch.
            passes: matrix products per matrix: 1 for values, 2 with slopes, 4 for an iteration by
                hand (values, slopes, tangents, weights), 6 for automatic double differentiation.
        """
        return 2 * passes * points * self.products


def _per_point(name: str) -> bool:
    return name.endswith((".weight", ".position")) and not name.startswith("time")


def started(network: Network, generator: torch.Generator) -> Tensor:
    """First values of all parameters, (size,) float32 on the CPU."""
    flat = torch.zeros(network.size)
    weights = network.views(flat)
    for name, weight in weights.items():
        if weight.ndim == 2:
            weight.copy_(torch.randn(weight.shape, generator=generator))
            weight.mul_(math.sqrt(2.0 / _inputs(network, name)))
    if network.config.start == "linear":
        _start_linear(network, weights, generator)
    elif network.config.start == "sphere":
        _start_sphere(network, weights)
    else:
        _start_he(network, weights)
    if network.config.output == "relu":
        weights["output.bias"].fill_(_ALIVE)
    if network.timed:
        _start_time(network, weights, generator)
    return flat


def _inputs(network: Network, name: str) -> int:
    """Inputs of the layer that a matrix belongs to, those of its other part included."""
    layer = name.split(".")[0]
    return sum(s[1] for n, s in network.shapes.items() if n.startswith(f"{layer}.") and len(s) == 2)


def _start_he(network: Network, weights: Weights) -> None:
    """Variance kept through the layers, waves in inverse proportion to their frequency so that no
    octave is steeper than another, and a small output: too large a d collapses to zero first."""
    octaves = math.pi * 2.0 ** torch.arange(network.config.position_frequencies)
    for name, weight in weights.items():
        if name.endswith(".position"):
            weight[:, 3:] /= octaves.repeat_interleave(6)
    weights["output.weight"].mul_(_SMALL)


def _start_linear(network: Network, weights: Weights, generator: torch.Generator) -> None:
    """Uniform between -1 / sqrt(inputs) and 1 / sqrt(inputs), biases too."""
    for name, weight in weights.items():
        if name != "time.frequencies":
            bound = 1 / math.sqrt(_inputs(network, name))
            weight.copy_(bound * (2 * torch.rand(weight.shape, generator=generator) - 1))


def _start_sphere(network: Network, weights: Weights) -> None:
    """Geometric start (Atzmon and Lipman 2020): |x| grows through layers of N(0, 2 / H), and the
    mean of the last one minus a radius is about the distance from a sphere. Waves start at zero,
    and d faint: the sphere only says which side is which, and a d that is too large collapses."""
    width = network.config.width
    for name, weight in weights.items():
        if name.startswith("layer") and weight.ndim == 2:
            weight.mul_(math.sqrt(_inputs(network, name) / width))
        if name.endswith(".position"):
            weight[:, 3:] = 0
            if not name.startswith("layer0."):
                weight.zero_()
    weights["output.weight"].fill_(_FAINT * math.sqrt(math.pi / width))
    weights["output.bias"].fill_(-_FAINT * SPHERE_RADIUS)


def _start_time(network: Network, weights: Weights, generator: torch.Generator) -> None:
    """Frequencies from N(0, 1); a scale of 1 and a shift of 0 with small deviations."""
    frequencies = weights["time.frequencies"]
    frequencies.copy_(torch.randn(frequencies.shape, generator=generator))
    modulated = network.config.width + network.embedded
    weights["time2.weight"].mul_(0.1)
    weights["time2.bias"].zero_()
    weights["time2.bias"][:modulated] = 1.0
