"""One round of message passing between lattice edges and faces: the heart of `parity`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from udflow.compiled import over_rows
from udflow.mesh import parity_loops
from udflow.mesh.lattice import find, shifted

PLANES = ((0, 1), (0, 2), (1, 2))
LIMIT = 12.0  # most that one face can say
DAMPING = 0.2  # share of what a face said before that stays
ACTIVE, RENEWAL = 6, 4  # steps around odd faces within which beliefs go on to change, and rounds
# after which it is looked again where that is


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

    Where all faces are even for some way around, nothing is left to be decided: after the first
    rounds only the surroundings of odd faces take part.

    Attributes:
        messages: (m + 1, 3, 4) float32: what the face in the plane xy, xz or yz of each vertex
            says to its edges, the two from the vertex and the two opposite; row m is zero.
        belief: (m + 1, 3) float32 of the edges along x, y, z from each vertex, negative for
            "crossed".
    """

    messages: Tensor
    belief: Tensor

    def round(self) -> int:
        """Renews the beliefs, and the messages by them: a face tells each edge the parity of the
        other three, as sure as the least sure of them.

        Returns:
            How many whole faces are odd by the beliefs.
        """
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
        self._odd = np.zeros(patch.count, dtype=np.uint8)
        self._active, self._rounds = np.arange(patch.count), 0

    def round(self) -> int:
        """See `Passing`."""
        messages, belief, active = self.messages.numpy(), self.belief.numpy(), self._active
        over_rows(
            parity_loops.believe,
            len(active),
            active,
            self._evidence,
            messages,
            self._behind,
            belief,
        )
        over_rows(
            parity_loops.tell, len(active), active, belief, self._ahead, LIMIT, DAMPING, messages,
            self._odd,
        )  # fmt: skip
        self._rounds += 1
        if self._rounds % RENEWAL == 0:
            self._active = parity_loops.around(self._odd, ACTIVE, self._ahead, self._behind)
        return int(self._odd.sum(dtype=np.int64))


class ByTensors:
    """On any device."""

    def __init__(self, patch: Patch, evidence: Tensor, messages: Tensor) -> None:
        self.messages, self.belief = messages, evidence.clone()
        self._patch, self._evidence = patch, evidence
        whole = [(patch.ahead[:, (p, q)] < patch.count).all(dim=1) for p, q in PLANES]
        self._whole = torch.stack(whole, dim=1)
        self._active, self._rounds = torch.ones_like(self._whole[:, 0]), 0

    def round(self) -> int:
        """See `Passing`."""
        active = self._active[:, None]
        self.belief[:-1] = torch.where(active, self._renewed_belief(), self.belief[:-1])
        odd = (self._at_corners((self.belief < 0).to(torch.int8)).sum(dim=2) % 2) == 1
        odd &= self._whole
        said = torch.where(active[..., None], self._renewed_messages(), self.messages[:-1])
        self.messages[:-1] = said
        self._rounds += 1
        if self._rounds % RENEWAL == 0:
            self._active = self._around(odd.any(dim=1))
        return int(odd.sum())

    def _renewed_belief(self) -> Tensor:
        belief, behind = self._evidence[:-1].clone(), self._patch.behind
        for plane, (p, q) in enumerate(PLANES):
            said = self.messages[:, plane]
            belief[:, p] += said[:-1, 0] + said[behind[:, q], 3]
            belief[:, q] += said[:-1, 1] + said[behind[:, p], 2]
        return belief

    def _renewed_messages(self) -> Tensor:
        heard = self._at_corners(self.belief) - self.messages[:-1]
        odd = (heard < 0).sum(dim=2, keepdim=True) % 2 == 1
        two = heard.abs().sort(dim=2)
        rank = two.indices.argsort(dim=2)
        sure = torch.where(rank == 0, two.values[..., 1:2], two.values[..., :1]).clamp_max(LIMIT)
        said = torch.where(odd ^ (heard < 0), -sure, sure) * self._whole[..., None]
        return DAMPING * self.messages[:-1] + (1 - DAMPING) * said

    def _around(self, odd: Tensor) -> Tensor:
        """(m,) whether vertices lie within ACTIVE steps of those with odd faces."""
        links = torch.cat([self._patch.ahead, self._patch.behind], dim=1)
        reached = torch.cat([odd, odd.new_zeros(1)])
        for _ in range(ACTIVE):
            reached[:-1] |= reached[links].any(dim=1)
        return reached[:-1]

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
