"""Message passing vertex by vertex: `parity` as compiled loops, the same to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np

from udflow.compiled import compiled

Array = Any  # a NumPy array inside a compiled loop


@compiled
def believe(
    start: int, stop: int, own: Array, messages: Array, behind: Array, belief: Array
) -> None:
    """Fills in what the edges of vertices start..stop believe: own evidence and four faces' word.

    Args:
        start, stop: rows.
        own: (m + 1, 3) evidence; row m stands for absent vertices.
        messages: (m + 1, 3, 4) from the faces in the planes xy, xz, yz of each vertex to their
            edges; row m stays zero.
        behind: (m, 3) previous vertices along the axes, m for none.
        belief: (m + 1, 3), filled in.
    """
    for i in range(start, stop):
        x, y, z = behind[i]
        here = messages[i]
        belief[i, 0] = own[i, 0] + (here[0, 0] + messages[y, 0, 3]) + (
            here[1, 0] + messages[z, 1, 3]
        )  # fmt: skip
        belief[i, 1] = own[i, 1] + (here[0, 1] + messages[x, 0, 2]) + (
            here[2, 0] + messages[z, 2, 3]
        )  # fmt: skip
        belief[i, 2] = own[i, 2] + (here[1, 1] + messages[x, 1, 2]) + (
            here[2, 1] + messages[y, 2, 2]
        )  # fmt: skip


@compiled
def count_odd(start: int, stop: int, belief: Array, ahead: Array, odd: Array) -> None:
    """Fills in, per vertex of start..stop, how many of its whole faces are odd.

    Args:
        start, stop: rows.
        belief: (m + 1, 3).
        ahead: (m, 3) following vertices along the axes, m for none.
        odd: (m,) uint8, filled in.
    """
    absent = len(ahead)
    for i in range(start, stop):
        total = 0
        for p, q in ((0, 1), (0, 2), (1, 2)):
            a, b = ahead[i, p], ahead[i, q]
            if a < absent and b < absent:
                low = (belief[i, p] < 0) ^ (belief[i, q] < 0)
                total += low ^ (belief[a, q] < 0) ^ (belief[b, p] < 0)
        odd[i] = total


@compiled
def tell(
    start: int, stop: int, belief: Array, ahead: Array, limit: float, damping: float,
    messages: Array,
) -> None:  # fmt: skip
    """Renews, in place, what the whole faces of vertices start..stop tell their edges.

    A face tells each edge the parity of the other three, as sure as the least sure of them, at
    most `limit`; `damping` is the share that stays of what it said before.
    """
    absent = len(ahead)
    renewed = np.float32(1.0 - damping)
    kept, most = np.float32(damping), np.float32(limit)
    heard = np.empty(4, np.float32)
    for i in range(start, stop):
        plane = -1
        for p, q in ((0, 1), (0, 2), (1, 2)):
            plane += 1
            a, b = ahead[i, p], ahead[i, q]
            said = messages[i, plane]
            if a == absent or b == absent:
                continue
            heard[0], heard[1] = belief[i, p] - said[0], belief[i, q] - said[1]
            heard[2], heard[3] = belief[a, q] - said[2], belief[b, p] - said[3]
            least, second, where, negative = np.float32(np.inf), np.float32(np.inf), 0, False
            for edge in range(4):
                sure = abs(heard[edge])
                negative ^= heard[edge] < 0
                if sure < least:
                    least, second, where = sure, least, edge
                elif sure < second:
                    second = sure
            for edge in range(4):
                word = min(second if edge == where else least, most)
                odd = negative ^ (heard[edge] < 0)
                said[edge] = kept * said[edge] + renewed * (-word if odd else word)
