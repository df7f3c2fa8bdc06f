"""Message passing vertex by vertex: `parity` as compiled loops, the same to the last bit."""

from __future__ import annotations

import numpy as np

from udflow.compiled import Array, compiled

Single = np.float32


@compiled
def believe(
    start: int, stop: int, active: Array, own: Array, messages: Array, behind: Array, belief: Array
) -> None:
    """Fills in what the edges of vertices active[start:stop] believe: own evidence and four
    faces' word.

    Args:
        start, stop: rows of `active`.
        active: (a,) vertices.
        own: (m + 1, 3) evidence; row m stands for absent vertices.
        messages: (m + 1, 3, 4) from the faces in the planes xy, xz, yz of each vertex to their
            edges; row m stays zero.
        behind: (m, 3) previous vertices along the axes, m for none.
        belief: (m + 1, 3), filled in.
    """
    for i in active[start:stop]:
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
def tell(
    start: int, stop: int, active: Array, belief: Array, ahead: Array, limit: float,
    damping: float, messages: Array, odd: Array,
) -> None:  # fmt: skip
    """Renews, in place, what the whole faces of vertices active[start:stop] tell their edges.

    A face tells each edge the parity of the other three, as sure as the least sure of them, at
    most `limit`; `damping` is the share that stays of what it said before.

    Args:
        start, stop, active: see `believe`.
        belief: (m + 1, 3).
        ahead: (m, 3) following vertices along the axes, m for none.
        limit, damping: see above.
        messages: see `believe`.
        odd: (m,) uint8, how many whole faces of each vertex are odd by the beliefs; filled in.
    """
    absent = len(ahead)
    renewed, kept, most = np.float32(1.0 - damping), np.float32(damping), np.float32(limit)
    for i in active[start:stop]:
        x, y, z = ahead[i]
        found = 0
        if x < absent and y < absent:
            found += _renew(messages[i, 0], belief[i, 0], belief[i, 1], belief[x, 1],
                            belief[y, 0], most, kept, renewed)  # fmt: skip
        if x < absent and z < absent:
            found += _renew(messages[i, 1], belief[i, 0], belief[i, 2], belief[x, 2],
                            belief[z, 0], most, kept, renewed)  # fmt: skip
        if y < absent and z < absent:
            found += _renew(messages[i, 2], belief[i, 1], belief[i, 2], belief[y, 2],
                            belief[z, 1], most, kept, renewed)  # fmt: skip
        odd[i] = found


@compiled
def _renew(
    said: Array, a: Single, b: Single, c: Single, d: Single,
    most: Single, kept: Single, renewed: Single,
) -> int:  # fmt: skip
    """Renews the four messages of a face whose edges believe a, b, c and d; 1 if it is odd."""
    is_odd = (a < 0) ^ (b < 0) ^ (c < 0) ^ (d < 0)
    a, b, c, d = a - said[0], b - said[1], c - said[2], d - said[3]
    odd = (a < 0) ^ (b < 0) ^ (c < 0) ^ (d < 0)
    sure_a, sure_b, sure_c, sure_d = abs(a), abs(b), abs(c), abs(d)
    ab, cd = min(sure_a, sure_b, most), min(sure_c, sure_d, most)
    to_a, to_b, to_c, to_d = min(sure_b, cd), min(sure_a, cd), min(ab, sure_d), min(ab, sure_c)
    said[0] = kept * said[0] + renewed * (-to_a if odd ^ (a < 0) else to_a)
    said[1] = kept * said[1] + renewed * (-to_b if odd ^ (b < 0) else to_b)
    said[2] = kept * said[2] + renewed * (-to_c if odd ^ (c < 0) else to_c)
    said[3] = kept * said[3] + renewed * (-to_d if odd ^ (d < 0) else to_d)
    return 1 if is_odd else 0


@compiled
def around(odd: Array, steps: int, ahead: Array, behind: Array) -> Array:
    """(a,) the vertices within some steps along edges of those with odd faces, sorted.

    Args:
        odd: (m,) uint8, how many odd faces each vertex has.
        steps: how many.
        ahead, behind: (m, 3) following and previous vertices, m for none.
    """
    count = len(odd)
    reached = np.zeros(count, dtype=np.bool_)
    front = np.flatnonzero(odd)
    reached[front] = True
    for _ in range(steps):
        found = np.empty(min(6 * len(front), count), dtype=np.int64)
        size = 0
        for i in front:
            for axis in range(3):
                for j in (ahead[i, axis], behind[i, axis]):
                    if j < count and not reached[j]:
                        reached[j] = True
                        found[size] = j
                        size += 1
        front = found[:size]
    return np.flatnonzero(reached)
