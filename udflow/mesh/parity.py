"""Repair of edge flags: around every lattice face an even number of edges is crossed.

Away from borders and junctions of sheets this parity must hold, so a face with an odd number says
that a flag near it is wrong, but not which. Finding the most credible set of flags with even
faces is the decoding of a low-density parity-check code: edges are its bits, faces its checks, and
min-sum message passing decodes it (Fossorier, Mihaljević and Imai 1999). Checks are soft, because
true borders exist: a face can outweigh the evidence only up to a limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.mesh.lattice import dilated, find, shifted

PLANES = ((0, 1), (0, 2), (1, 2))
REACH = 3  # vertices around an odd face that take part
ITERATIONS = 80
PATIENCE = 20  # iterations without fewer odd faces before giving up: a true border stays odd
LIMIT = 12.0  # most that one face can say
DAMPING = 0.2
_ABSENT = 30.0  # evidence for "not crossed" where an edge leaves the band


def odd_faces(flags: Tensor, ahead: Tensor) -> Tensor:
    """(n, 3) whether the face from each vertex in the planes xy, xz, yz is odd.

    Args:
        flags: (n, 3) crossed edges along x, y, z from each vertex.
        ahead: (n, 3) index of the next vertex along each axis, -1 where there is none.
    """
    padded = torch.cat([flags, flags.new_zeros(1, 3)])
    columns = [
        flags[:, p] ^ flags[:, q] ^ padded[ahead[:, p], q] ^ padded[ahead[:, q], p]
        for p, q in PLANES
    ]
    return torch.stack(columns, dim=1)


def decoded(keys: Tensor, ahead: Tensor, evidence: Tensor) -> Tensor:
    """Flags (n, 3) with as many even faces as the evidence allows.

    Args:
        keys: (n,) sorted lattice vertices.
        ahead: (n, 3) index of the next vertex along each axis, -1 where there is none.
        evidence: (n, 3) log-likelihood ratio of "not crossed" against "crossed".
    """
    flags = (evidence < 0) & (ahead >= 0)
    odd = odd_faces(flags, ahead).any(dim=1)
    if not bool(odd.any()):
        return flags
    patch_keys = keys[odd]
    for _ in range(REACH):
        patch_keys = dilated(patch_keys)
    source = find(keys, patch_keys)
    member = (source >= 0).nonzero()[:, 0]
    source = source[member]
    local = torch.full((len(patch_keys), 3), _ABSENT, device=keys.device)
    local[member] = torch.where(ahead[source] >= 0, evidence[source], _ABSENT)
    flags[source] = _decode(_Patch.of(patch_keys), local)[member] & (ahead[source] >= 0)
    return flags


@dataclass(frozen=True)
class _Patch:
    """Neighbours inside a set of m vertices; m itself stands for an absent vertex."""

    ahead: tuple[Tensor, ...]
    behind: tuple[Tensor, ...]

    @classmethod
    def of(cls, keys: Tensor) -> _Patch:
        count = len(keys)
        ahead: list[Tensor] = []
        behind: list[Tensor] = []
        for axis in range(3):
            for by, indices in ((1, ahead), (-1, behind)):
                place = find(keys, shifted(keys, axis, by))
                indices.append(torch.where(place < 0, count, place))
        return cls(tuple(ahead), tuple(behind))


def _decode(patch: _Patch, evidence: Tensor) -> Tensor:
    """(m, 3) flags after message passing; evidence (m, 3) is negative for "crossed"."""
    count = len(evidence)
    own = [torch.cat([column, column.new_full((1,), _ABSENT)]) for column in evidence.unbind(1)]
    complete = [(patch.ahead[p] < count) & (patch.ahead[q] < count) for p, q in PLANES]
    messages = [evidence.new_zeros(4, count + 1) for _ in PLANES]
    best, fewest, since = evidence < 0, count * 3 + 1, 0
    for _ in range(ITERATIONS):
        belief = _belief(patch, own, messages)
        odd = _count_odd(patch, belief, complete)
        since += 1
        if odd < fewest:
            best, fewest, since = torch.stack([b[:-1] < 0 for b in belief], dim=1), odd, 0
        if odd == 0 or since > PATIENCE:
            break
        for plane, (p, q) in enumerate(PLANES):
            heard = _at_corners(patch, belief, p, q) - messages[plane][:, :-1]
            said = _check(heard) * complete[plane]
            messages[plane][:, :-1].mul_(DAMPING).add_(said, alpha=1 - DAMPING)
    return best


def _belief(patch: _Patch, own: list[Tensor], messages: list[Tensor]) -> list[Tensor]:
    """Per axis (m + 1,): an edge's own evidence and what its four faces say."""
    belief = [column.clone() for column in own]
    for message, (p, q) in zip(messages, PLANES, strict=True):
        belief[p][:-1] += message[0, :-1] + message[3][patch.behind[q]]
        belief[q][:-1] += message[1, :-1] + message[2][patch.behind[p]]
    return belief


def _at_corners(patch: _Patch, values: list[Tensor], p: int, q: int) -> Tensor:
    """(4, m) values of the edges of each face: two from its vertex, two opposite."""
    here_p, here_q = values[p][:-1], values[q][:-1]
    return torch.stack([here_p, here_q, values[q][patch.ahead[p]], values[p][patch.ahead[q]]])


def _check(heard: Tensor) -> Tensor:
    """What a face tells each of its (4, m) edges: the parity of the other three, as sure as the
    least sure of them."""
    sign = torch.where(heard < 0, -1.0, 1.0)
    a, b, c, d = heard.abs().unbind(0)
    ab, cd = torch.minimum(a, b), torch.minimum(c, d)
    others = [torch.minimum(b, cd), torch.minimum(a, cd), torch.minimum(ab, d)]
    sure = torch.stack([*others, torch.minimum(ab, c)]).clamp_max_(LIMIT)
    return sure * (sign.prod(dim=0) * sign)


def _count_odd(patch: _Patch, belief: list[Tensor], complete: list[Tensor]) -> int:
    total = 0
    for (p, q), whole in zip(PLANES, complete, strict=True):
        negative = _at_corners(patch, belief, p, q) < 0
        odd = negative[0] ^ negative[1] ^ negative[2] ^ negative[3]
        total += int((odd & whole).sum())
    return total
