"""Through the network and back: s(x, t), its slope in x, and the gradient of both by hand.

Equation (8) puts a slope of the network into the loss, so that training needs second derivatives.
Automatic differentiation takes six matrix products per matrix for them. Four are enough where the
activation is linear in pieces:

    values    z_l = W_l h_l + b_l,  h_{l+1} = max(z_l, 0)                              (forward)
    slopes    a_l = m_l * (W_{l+1}^T a_{l+1}),  m_l = [z_l > 0],  grad_x s = W_0^T a_0  (reverse)
    tangents  u_{l+1} = m_l * (W_l u_l),  u_0 = c                                      (forward)
    weights   d/dW_l (alpha s + c . grad_x s) = a_l (alpha h_l + u_l)^T

for a loss L(s, g) with alpha = dL/ds and c = dL/dg: c . g is the derivative of s along c, which the
tangents carry forward, and masks are constant almost everywhere. FiLM is folded into the matrices,
W (scale * h + shift) + b = (W scale) h + (W shift + b), one matrix per time: a batch holds equal
blocks of points, one block per time.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.fields.embedding import Modulation, PositionEmbedding, modulation
from udflow.fields.network import Network, Weights


@dataclass(frozen=True)
class Layer:
    """One layer with the modulation folded in.

    Attributes:
        weight: (H, H) acts on h_l, None in layer 0; (T, H, H) where modulated.
        position: (H, P) acts on h_0, None in layers without it; (T, H, P) where modulated.
        bias: (H,); (T, 1, H) where modulated.
    """

    weight: Tensor | None
    position: Tensor | None
    bias: Tensor

    def values(self, hidden: Tensor, embedded: Tensor, out: Tensor) -> None:
        """out = hidden weight^T + embedded position^T + bias, (n, H)."""
        blocks = out.view(len(self.bias), -1, out.shape[1]) if self.bias.ndim == 3 else out
        blocks.copy_(self.bias)
        for rows, matrix in ((hidden, self.weight), (embedded, self.position)):
            if matrix is not None:
                _transform(rows, matrix.mT, out, add=True)

    def tangents(self, hidden: Tensor, embedded: Tensor, out: Tensor) -> None:
        """`values` without the bias."""
        if self.weight is not None:
            _transform(hidden, self.weight.mT, out, add=False)
        if self.position is not None:
            _transform(embedded, self.position.mT, out, add=self.weight is not None)


def _transform(rows: Tensor, matrix: Tensor, out: Tensor, *, add: bool) -> None:
    """out (+)= rows matrix; a (T, ., .) matrix takes T equal blocks of rows."""
    beta = 1 if add else 0
    if matrix.ndim == 3:
        out = out.view(len(matrix), -1, out.shape[1])
        out.baddbmm_(rows.view(len(matrix), -1, rows.shape[1]), matrix, beta=beta)
    else:
        out.addmm_(rows, matrix, beta=beta)


@dataclass(frozen=True)
class TimedNetwork:
    """A network at some times: what is the same for all points.

    Attributes:
        network: shapes.
        weights: the parameters.
        modulation: scales and shifts of the times, None where there are none.
        layers: with the modulation folded in.
    """

    network: Network
    weights: Weights
    modulation: Modulation | None
    layers: tuple[Layer, ...]

    @classmethod
    def at(cls, network: Network, weights: Weights, times: Tensor) -> TimedNetwork:
        """The network at (T,) times."""
        modulated = modulation(network, weights, times)
        layers = tuple(
            _folded(network, weights, modulated, layer) for layer in range(network.config.layers)
        )
        return cls(network, weights, modulated, layers)


def _folded(network: Network, weights: Weights, modulated: Modulation | None, layer: int) -> Layer:
    weight = weights.get(f"layer{layer}.weight")
    position = weights.get(f"layer{layer}.position")
    bias = weights[f"layer{layer}.bias"]
    if modulated is None or layer not in network.config.film:
        return Layer(weight, position, bias)
    bias = bias[None, None]
    parts: list[Tensor | None] = []
    for matrix, columns in zip((weight, position), _columns(network), strict=True):
        if matrix is not None:
            bias = bias + (modulated.shift[:, columns] @ matrix.T)[:, None]
            parts.append(matrix * modulated.scale[:, None, columns])
        else:
            parts.append(None)
    return Layer(parts[0], parts[1], bias)


def _columns(network: Network) -> tuple[slice, slice]:
    """Columns of scale and shift that belong to h_l and to h_0."""
    width = network.config.width
    return slice(0, width), slice(width, width + network.embedded)


class Pass:
    """Room for one batch on its way through a network; used again for every batch.

    Args:
        network: shapes.
        rows: points in a batch.
        like: a tensor of the device and precision of the matrix products.
    """

    def __init__(self, network: Network, rows: int, like: Tensor) -> None:
        layers, width = network.config.layers, network.config.width
        self.network = network
        self.rows = rows
        self._hidden = [like.new_empty(rows, width) for _ in range(layers)]
        self._adjoint = [like.new_empty(rows, width) for _ in range(layers)]
        self._spare = [like.new_empty(rows, width) for _ in range(3)]
        self._position = like.new_empty(rows, network.embedded)

    def run(self, timed: TimedNetwork, points: Tensor) -> tuple[Tensor, Tensor]:
        """Values and slopes.

        Args:
            timed: the network at T times.
            points: (rows, 3); T equal blocks, one per time.

        Returns:
            s, (rows,), before the output activation, and its gradient by x, (rows, 3), in the
            precision of the points.
        """
        self._timed = timed
        self._embedding = PositionEmbedding.of(points, self.network.config.position_frequencies)
        self._embedded = hidden = self._embedding.values.to(self._position.dtype)
        for layer, out in zip(timed.layers, self._hidden, strict=True):
            layer.values(hidden, self._embedded, out)
            hidden = out.relu_()
        weights = timed.weights
        value = torch.addmv(weights["output.bias"], hidden, weights["output.weight"][0])
        return value.to(points.dtype), self._slopes(points.dtype)

    def _slopes(self, dtype: torch.dtype) -> Tensor:
        layers = self._timed.layers
        last = self._timed.weights["output.weight"]
        self._adjoint[-1].copy_(last.expand(self.rows, -1))
        self._position.zero_()
        for number in range(len(layers) - 1, -1, -1):
            layer, adjoint = layers[number], self._adjoint[number]
            _mask(adjoint, self._hidden[number])
            if layer.position is not None:
                _transform(adjoint, layer.position, self._position, add=True)
            if layer.weight is not None:
                _transform(adjoint, layer.weight, self._adjoint[number - 1], add=False)
        return self._embedding.gradient(self._position.to(dtype))

    def pull_back(self, by_value: Tensor, by_slope: Tensor, gradients: Weights) -> None:
        """Gradient of a loss L(s, grad_x s) by all parameters, for the batch of the last `run`.

        Args:
            by_value: dL/ds, (rows,).
            by_slope: dL/d(grad_x s), (rows, 3).
            gradients: written, every entry; of the precision of the matrix products.
        """
        alpha = by_value.to(self._position.dtype)
        embedded_tangent = self._embedding.tangent(by_slope).to(alpha.dtype)
        embedded_mixed = torch.addcmul(embedded_tangent, self._embedded, alpha[:, None])
        collected = _ModulationGradient.of(self._timed)
        tangent, mixed = embedded_tangent, embedded_mixed
        for number, layer in enumerate(self._timed.layers):
            parts = {"weight": mixed, "position": embedded_mixed}
            self._pull_back_layer(number, parts, alpha, gradients, collected)
            out = self._spare[number % 2]
            layer.tangents(tangent, embedded_tangent, out)
            tangent = _mask(out, self._hidden[number])
            mixed = torch.addcmul(tangent, self._hidden[number], alpha[:, None], out=self._spare[2])
        torch.sum(mixed, dim=0, keepdim=True, out=gradients["output.weight"])
        torch.sum(alpha, dim=0, keepdim=True, out=gradients["output.bias"])
        collected.pull_back(gradients)

    def _pull_back_layer(
        self,
        number: int,
        parts: dict[str, Tensor],
        alpha: Tensor,
        gradients: Weights,
        collected: _ModulationGradient,
    ) -> None:
        """Gradients of one layer: a (alpha h + u)^T for its matrices, a alpha for its bias."""
        adjoint, bias = self._adjoint[number], gradients[f"layer{number}.bias"]
        names = [name for name in parts if f"layer{number}.{name}" in gradients]
        if self._timed.layers[number].bias.ndim == 1:
            for name in names:
                torch.mm(adjoint.T, parts[name], out=gradients[f"layer{number}.{name}"])
            torch.mv(adjoint.T, alpha, out=bias)
            return
        blocks = adjoint.view(collected.times, -1, adjoint.shape[1]).mT
        by_bias = (blocks @ alpha.view(collected.times, -1, 1)).squeeze(2)
        torch.sum(by_bias, dim=0, out=bias)
        for name in names:
            by_matrix = blocks @ parts[name].view(collected.times, -1, parts[name].shape[1])
            gradients[f"layer{number}.{name}"].copy_(
                collected.unfolded(f"layer{number}.{name}", by_matrix, by_bias)
            )


def _mask(rows: Tensor, hidden: Tensor) -> Tensor:
    """Zeroes `rows` in place where the rectified `hidden` is zero; one kernel, no temporaries."""
    torch.ops.aten.threshold_backward.grad_input(rows, hidden, 0, grad_input=rows)
    return rows


@dataclass(frozen=True)
class _ModulationGradient:
    """Gradients of scale and shift, summed over the layers that share them."""

    timed: TimedNetwork
    times: int
    scale: Tensor
    shift: Tensor

    @classmethod
    def of(cls, timed: TimedNetwork) -> _ModulationGradient:
        modulated = timed.modulation
        if modulated is None:
            empty = timed.weights["output.bias"].new_empty(0)
            return cls(timed, 0, empty, empty)
        zero = torch.zeros_like(modulated.scale)
        return cls(timed, len(zero), zero, torch.zeros_like(zero))

    def unfolded(self, name: str, by_matrix: Tensor, by_bias: Tensor) -> Tensor:
        """Gradient of a matrix W from those of W scale_t, (T, H, .), and of W shift_t + b, (T, H);
        what scale and shift get of it is added up."""
        modulated, weight = self.timed.modulation, self.timed.weights[name]
        if modulated is None:
            raise ValueError(f"{name} is not modulated")
        columns = _columns(self.timed.network)[name.endswith("position")]
        scale, shift = modulated.scale[:, columns], modulated.shift[:, columns]
        self.scale[:, columns] += (by_matrix * weight).sum(dim=1)
        self.shift[:, columns] += by_bias @ weight
        return (by_matrix * scale[:, None]).sum(dim=0) + by_bias.T @ shift

    def pull_back(self, gradients: Weights) -> None:
        """Writes the gradients of the time parameters."""
        if self.timed.modulation is not None:
            self.timed.modulation.pull_back(self.scale, self.shift, self.timed.weights, gradients)
