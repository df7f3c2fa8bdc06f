"""One round of message passing between lattice edges and faces: the heart of `parity`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from udflow.compiled import over_rows
from udflow.mesh import parity_loops
from udflow.mesh.lattice import find, shifted

PLANES = ((0, 1), (0, 2), (1, 2))
LIMIT = 12.0  # most that one face can say
DAMPING = 0.2  # share of what a face said before that stays


@dataclass(frozen=True)
class Patch:
    """Neighbours inside a set of m vertices; m itself stands for an absent vertex.

    Attributes:
        count: m.
        ahead, behind: (m, 3) int64 the next and the previous vertex along each axis.
    """

    count: int
    ahead: Tensor
    behind: Tensor

    @classmethod
    def of(cls, keys: Tensor) -> Patch:
        """The patch of (m,) sorted lattice vertices."""
        count = len(keys)
        places = [
            torch.stack([find(keys, shifted(keys, axis, by)) for axis in range(3)], dim=1)
            for by in (1, -1)
        ]
        return cls(count, *(torch.where(place < 0, count, place) for place in places))


class Passing(Protocol):
    """The state of message passing on a patch of m vertices.

    Attributes:
        messages: (m + 1, 3, 4) float32: what the face in the plane xy, xz or yz of each vertex
            says to its edges, the two from the vertex and the two opposite; row m is zero.
        belief: (m + 1, 3) float32 of the edges along x, y, z from each vertex, negative for
            "crossed".
    """

    messages: Tensor
    belief: Tensor

    def believe(self) -> int:
        """Renews the beliefs; returns how many whole faces are odd by them."""
        ...

    def tell(self) -> None:
        """Renews the messages: a face tells each edge the parity of the other three, as sure as
        the least sure of them."""
        ...


def passing(patch: Patch, evidence: Tensor, messages: Tensor) -> Passing:
    """Message passing on the device of the tensors.

    Args:
        patch: the vertices.
        evidence: (m + 1, 3) of the edges from each vertex, row m for those that are absent.
        messages: (m + 1, 3, 4), changed in place.
    """
    by = ByLoops if evidence.device.type == "cpu" else ByTensors
    return by(patch, evidence, messages)


class ByLoops:
    """On the CPU, vertex by vertex."""

    def __init__(self, patch: Patch, evidence: Tensor, messages: Tensor) -> None:
        self.messages, self.belief = messages, evidence.clone()
        self._evidence = evidence.numpy()
        self._ahead, self._behind = patch.ahead.numpy(), patch.behind.numpy()
        self._odd = torch.empty(patch.count, dtype=torch.uint8)

    def believe(self) -> int:
        """See `Passing`."""
        belief = self.belief.numpy()
        arrays = self._evidence, self.messages.numpy(), self._behind, belief
        over_rows(parity_loops.believe, len(self._odd), *arrays)
        over_rows(parity_loops.count_odd, len(self._odd), belief, self._ahead, self._odd.numpy())
        return int(self._odd.sum())

    def tell(self) -> None:
        """See `Passing`."""
        numbers = LIMIT, DAMPING, self.messages.numpy()
        over_rows(parity_loops.tell, len(self._odd), self.belief.numpy(), self._ahead, *numbers)


class ByTensors:
    """On any device."""

    def __init__(self, patch: Patch, evidence: Tensor, messages: Tensor) -> None:
        self.messages, self.belief = messages, evidence.clone()
        self._patch, self._evidence = patch, evidence
        whole = [(patch.ahead[:, (p, q)] < patch.count).all(dim=1) for p, q in PLANES]
        self._whole = torch.stack(whole, dim=1)

    def believe(self) -> int:
        """See `Passing`."""
        belief, behind = self._evidence.clone(), self._patch.behind
        for plane, (p, q) in enumerate(PLANES):
            said = self.messages[:, plane]
            belief[:-1, p] += said[:-1, 0] + said[behind[:, q], 3]
            belief[:-1, q] += said[:-1, 1] + said[behind[:, p], 2]
        self.belief = belief
        crossed = self._at_corners((belief < 0).to(torch.int8)).sum(dim=2)
        return int(((crossed % 2 == 1) & self._whole).sum())

    def tell(self) -> None:
        """See `Passing`."""
        heard = self._at_corners(self.belief) - self.messages[:-1]
        odd = (heard < 0).sum(dim=2, keepdim=True) % 2 == 1
        two = heard.abs().sort(dim=2)
        rank = two.indices.argsort(dim=2)
        sure = torch.where(rank == 0, two.values[..., 1:2], two.values[..., :1]).clamp_max(LIMIT)
        said = torch.where(odd ^ (heard < 0), -sure, sure) * self._whole[..., None]
        self.messages[:-1] = DAMPING * self.messages[:-1] + (1 - DAMPING) * said

    def _at_corners(self, values: Tensor) -> Tensor:
        """(m, 3, 4) values (m + 1, 3) of the edges of each face: two from its vertex, two
        opposite."""
        ahead = self._patch.ahead
        faces = [
            torch.stack(
                [values[:-1, p], values[:-1, q], values[ahead[:, p], q], values[ahead[:, q], p]],
                dim=1,
            )
            for p, q in PLANES
        ]
        return torch.stack(faces, dim=1)
