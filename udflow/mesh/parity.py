"""Repair of edge flags: around every lattice face an even number of edges is crossed.

Away from borders and junctions of sheets this parity must hold, so a face with an odd number says
that a flag near it is wrong, but not which. Finding the most credible set of flags with even
faces is the decoding of a low-density parity-check code: edges are its bits, faces its checks, and
min-sum message passing decodes it (Fossorier, Mihaljević and Imai 1999). Checks are soft, because
true borders exist: a face can outweigh the evidence only up to a limit.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from udflow.mesh.lattice import dilated, find, reversed_links, shifted
from udflow.mesh.messages import PLANES, Patch, passing
from udflow.mesh.topology import parts

REACH = 3  # vertices around an odd face that take part
ITERATIONS = 60
PATIENCE = 12  # iterations without fewer odd faces before giving up: a true border stays odd
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
        self._patch = Patch.of(patch_keys)
        self._messages = evidence.new_zeros(len(patch_keys) + 1, 3, 4)

    def flags(self, evidence: Tensor) -> Tensor:
        """(n, 3) crossed edges with as many even faces as the evidence allows."""
        flags = (evidence < 0) & (self._ahead >= 0)
        if len(self._source) == 0:
            return flags
        exists = self._ahead[self._source] >= 0
        local = evidence.new_full((self._patch.count + 1, 3), _ABSENT)
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


def _decode(patch: Patch, evidence: Tensor, messages: Tensor) -> Tensor:
    """(m, 3) flags after message passing; evidence (m + 1, 3) is negative for "crossed"."""
    state = passing(patch, evidence, messages)
    best, fewest, since = evidence[:-1] < 0, 3 * patch.count + 1, 0
    for _ in range(ITERATIONS):
        odd = state.round()
        since += 1
        if odd < fewest:
            best, fewest, since = state.belief[:-1] < 0, odd, 0
        if odd == 0 or since > PATIENCE:
            break
    return best
