"""Repair of edge flags: around every lattice face an even number of edges is crossed.

Away from borders and junctions of sheets this parity must hold, so a face with an odd number says
that a flag near it is wrong, but not which. Finding the most credible set of flags with even
faces is the decoding of a low-density parity-check code: edges are its bits, faces its checks, and
min-sum message passing decodes it (Fossorier, Mihaljević and Imai 1999). Checks are soft, because
true borders exist: a face can outweigh the evidence only up to a limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from udflow.mesh.lattice import dilated, find, reversed_links, shifted
from udflow.mesh.topology import parts

PLANES = ((0, 1), (0, 2), (1, 2))
REACH = 3  # vertices around an odd face that take part
ITERATIONS = 60
PATIENCE = 12  # iterations without fewer odd faces before giving up: a true border stays odd
LIMIT = 12.0  # most that one face can say
DAMPING = 0.2
SUCCESS = 0.5  # share of its odd faces that a region may keep
PLAIN_REPAIRS = 6
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


class Decoder:
    """Message passing on the faces near contradictions; it can go on after evidence changed."""

    def __init__(self, keys: Tensor, ahead: Tensor, evidence: Tensor) -> None:
        """Takes the vertices around the odd faces of the flags that the evidence suggests.

        Args:
            keys: (n,) sorted lattice vertices.
            ahead: (n, 3) index of the next vertex along each axis, -1 where there is none.
            evidence: (n, 3) log-likelihood ratio of "not crossed" against "crossed".
        """
        odd = odd_faces((evidence < 0) & (ahead >= 0), ahead).any(dim=1)
        patch_keys = keys[odd]
        for _ in range(REACH):
            patch_keys = dilated(patch_keys)
        patch_keys = _with_edges(keys, patch_keys)
        source = find(keys, patch_keys)
        self._ahead = ahead
        self._member = (source >= 0).nonzero()[:, 0]
        self._source = source[self._member]
        self._patch = _Patch.of(patch_keys)
        self._messages = [evidence.new_zeros(4, len(patch_keys) + 1) for _ in PLANES]

    def flags(self, evidence: Tensor) -> Tensor:
        """(n, 3) crossed edges with as many even faces as the evidence allows."""
        flags = (evidence < 0) & (self._ahead >= 0)
        if len(self._source) == 0:
            return flags
        exists = self._ahead[self._source] >= 0
        local = evidence.new_full((self._patch.count, 3), _ABSENT)
        local[self._member] = torch.where(exists, evidence[self._source], _ABSENT)
        decided = _decode(self._patch, local, self._messages)
        flags[self._source] = decided[self._member] & exists
        return flags


def settled(keys: Tensor, ahead: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Flags (n, 3) after decoding, but as they were before around true borders.

    There decoding cannot succeed: it only crumples the border on its way to the end of the band.
    Each connected region of changes and odd faces is taken only if most of its odd faces became
    even; the others get the plain repair, which leaves borders alone.

    Args:
        keys: (n,) sorted lattice vertices.
        ahead: (n, 3) index of the next vertex along each axis, -1 where there is none.
        before, after: (n, 3) flags.
    """
    odd_before = odd_faces(before, ahead).sum(dim=1)
    odd_after = odd_faces(after, ahead).sum(dim=1)
    changed = (before != after).any(dim=1)
    member = ((odd_before > 0) | (odd_after > 0) | changed).nonzero()[:, 0]
    if len(member) == 0:
        return after
    region = _regions(keys[member])
    count = int(region.max()) + 1
    was = torch.bincount(region, odd_before[member].float(), count)
    became = torch.bincount(region, odd_after[member].float(), count)
    failed = member[(became > SUCCESS * was)[region]]
    flags = after.clone()
    flags[failed] = before[failed]
    return _plainly_repaired(flags, ahead)


def _regions(keys: Tensor) -> Tensor:
    """(k,) number of the connected region of each of k sorted vertices, where vertices up to two
    apart along every axis are connected."""
    near = dilated(keys)
    place = torch.arange(len(near), device=keys.device)
    pairs = []
    for axis in range(3):
        following = find(near, shifted(near, axis, 1))
        pairs.append(torch.stack([place, following], dim=1)[following >= 0])
    label = parts(torch.cat(pairs).cpu().numpy(), len(near))
    label_of_keys = label[find(near, keys).cpu().numpy()]
    number = np.unique(label_of_keys, return_inverse=True)[1].reshape(-1)
    return torch.from_numpy(number).to(keys.device)


def _plainly_repaired(flags: Tensor, ahead: Tensor) -> Tensor:
    """Flags (n, 3) after flipping edges at which three or all four faces are odd.

    One wrong flag makes its four faces odd; a true border makes at most two odd at an edge.
    """
    behind = reversed_links(ahead)
    for _ in range(PLAIN_REPAIRS):
        odd = odd_faces(flags, ahead).to(torch.int8)
        padded = torch.cat([odd, odd.new_zeros(1, 3)])
        count = torch.zeros_like(odd)
        for plane, (p, q) in enumerate(PLANES):
            count[:, p] += odd[:, plane] + padded[behind[:, q], plane]
            count[:, q] += odd[:, plane] + padded[behind[:, p], plane]
        wrong = (count >= 3) & (ahead >= 0)
        if not bool(wrong.any()):
            break
        flags = flags ^ wrong
    return flags


def _with_edges(keys: Tensor, candidates: Tensor) -> Tensor:
    """Those candidates that are vertices or lie right before one: only their faces matter."""
    matters = find(keys, candidates) >= 0
    for axis in range(3):
        matters |= find(keys, shifted(candidates, axis, 1)) >= 0
    return candidates[matters]


@dataclass(frozen=True)
class _Patch:
    """Neighbours inside a set of `count` vertices; `count` itself stands for an absent vertex."""

    count: int
    ahead: tuple[Tensor, ...]
    behind: tuple[Tensor, ...]
    complete: tuple[Tensor, ...]

    @classmethod
    def of(cls, keys: Tensor) -> _Patch:
        count = len(keys)
        ahead: list[Tensor] = []
        behind: list[Tensor] = []
        for axis in range(3):
            for by, indices in ((1, ahead), (-1, behind)):
                place = find(keys, shifted(keys, axis, by))
                indices.append(torch.where(place < 0, count, place))
        complete = tuple((ahead[p] < count) & (ahead[q] < count) for p, q in PLANES)
        return cls(count, tuple(ahead), tuple(behind), complete)


def _decode(patch: _Patch, evidence: Tensor, messages: list[Tensor]) -> Tensor:
    """(m, 3) flags after message passing; evidence (m, 3) is negative for "crossed"."""
    own = [torch.cat([column, column.new_full((1,), _ABSENT)]) for column in evidence.unbind(1)]
    best, fewest, since = evidence < 0, 3 * patch.count + 1, 0
    for _ in range(ITERATIONS):
        belief = _belief(patch, own, messages)
        odd = _count_odd(patch, belief)
        since += 1
        if odd < fewest:
            best, fewest, since = torch.stack([b[:-1] < 0 for b in belief], dim=1), odd, 0
        if odd == 0 or since > PATIENCE:
            break
        for plane, (p, q) in enumerate(PLANES):
            heard = _at_corners(patch, belief, p, q) - messages[plane][:, :-1]
            said = _check(heard) * patch.complete[plane]
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


def _count_odd(patch: _Patch, belief: list[Tensor]) -> int:
    negative = [values < 0 for values in belief]
    total = 0
    for (p, q), whole in zip(PLANES, patch.complete, strict=True):
        odd = negative[p][:-1] ^ negative[q][:-1]
        odd ^= negative[q][patch.ahead[p]] ^ negative[p][patch.ahead[q]]
        total += int((odd & whole).sum())
    return total
