"""A KD-tree over samples and its look-ups, as compiled loops: see `neighbours`.

The tree is balanced and has no pointers: node i has the children 2 i + 1 and 2 i + 2, the nodes of
a level share the samples in equal parts, and samples are stored in the order of the leaves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from udflow.compiled import Array, compiled

_LEAF = 16  # samples of a leaf, at most
_DEPTH = 64  # more than any tree has
_FEW = 16  # numbers that are sorted as they are
_NONE = 0x7FFFFFFFFFFFFFFF  # a key beyond all others


def levels_of(count: int) -> int:
    """Levels below the root of a tree over some samples."""
    return (max(count - 1, 0) // _LEAF).bit_length()


@compiled
def build_tree(points: Array, order: Array, levels: int, boxes: Array) -> None:
    """Sorts samples into a tree.

    Args:
        points: (3, m) float32 samples, put into the order of the leaves.
        order: (m,) int32 their indices, put into the same order.
        levels: see `levels_of`.
        boxes: (2^(levels + 1) - 1, 6) float32, filled in: least and largest coordinates.
    """
    count = len(order)
    for level in range(levels + 1):
        first = (1 << level) - 1
        for place in range(1 << level):
            start, stop = (count * place) >> level, (count * (place + 1)) >> level
            axis = _bound(points, start, stop, boxes[first + place])
            if level < levels:
                middle = (count * (2 * place + 1)) >> (level + 1)
                _divide(points, order, start, stop, middle, axis)


@compiled
def _bound(points: Array, start: int, stop: int, box: Array) -> int:
    """Fills in the box of samples start..stop, and tells its longest side."""
    widest, longest = 0, np.float32(-1)
    for axis in range(3):
        least = largest = points[axis, start]
        for i in range(start + 1, stop):
            least, largest = min(least, points[axis, i]), max(largest, points[axis, i])
        box[axis], box[axis + 3] = least, largest
        if largest - least > longest:
            widest, longest = axis, largest - least
    return widest


@compiled
def _divide(points: Array, order: Array, start: int, stop: int, middle: int, axis: int) -> None:
    """Puts those of start..stop that are least along an axis before middle (quickselect)."""
    low, high, along = start, stop - 1, points[axis]
    while low < high:
        a, b, c = along[low], along[(low + high) >> 1], along[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while along[i] < pivot:
                i += 1
            while along[j] > pivot:
                j -= 1
            if i <= j:
                for other in range(3):
                    points[other, i], points[other, j] = points[other, j], points[other, i]
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@compiled
def nearest_rows(
    start: int, stop: int, queries: Array, points: Array, order: Array, place: Array,
    levels: int, boxes: Array, distance: Array, index: Array,
) -> None:  # fmt: skip
    """The k nearest samples of queries start..stop, nearest first, of equally near ones the first.

    None of them is farther than what was nearest to the query before, which lies next to it where
    queries come in the order of a lattice.

    Args:
        start, stop: rows.
        queries: (n, 3) float32.
        points, order, levels, boxes: the tree, see `build_tree`.
        place: (m,) int32 where in that order each sample is.
        distance, index: (n, k) float32 and int64, filled in; k at most the number of samples.
    """
    k = index.shape[1]
    room = 2 * k + 32
    # a key is the bits of a squared distance, which are in its order, and below them an index
    keys, spare = np.empty(room + _LEAF, np.int64), np.empty(room + _LEAF, np.int64)
    ends = np.empty(room + _LEAF + 1, np.int32)
    square, value = np.empty(_LEAF, np.float32), np.empty(2, np.float32)
    squared, bits = square.view(np.int32), value.view(np.int32)
    nodes, far = np.empty(_DEPTH, np.int64), np.empty(_DEPTH, np.float32)
    count, leaves = len(order), (1 << levels) - 1
    for row in range(start, stop):
        x, y, z = queries[row, 0], queries[row, 1], queries[row, 2]
        found, limit, bound, full = 0, np.int64(_NONE), np.float32(np.inf), k + _LEAF
        if row > start:
            value[0] = _farthest(index[row - 1], x, y, z, points, place)
            limit, bound = (np.int64(bits[0]) << 32) | 0xFFFFFFFF, value[0]
        nodes[0], far[0], top = 0, np.float32(0), 1
        while top > 0:
            top -= 1
            node, away = nodes[top], far[top]
            while node < leaves and away <= bound:
                one = 2 * node + 1
                away, other = _outside(boxes[one], x, y, z), _outside(boxes[one + 1], x, y, z)
                node, two = one, one + 1
                if other < away:
                    node, two, away, other = two, node, other, away
                nodes[top], far[top] = two, other
                top += other <= bound
            if away > bound:
                continue
            first = (count * (node - leaves)) >> levels
            size = ((count * (node - leaves + 1)) >> levels) - first
            for i in range(size):
                dx, dy = points[0, first + i] - x, points[1, first + i] - y
                dz = points[2, first + i] - z
                square[i] = dx * dx + dy * dy + dz * dz
            for i in range(size):
                key = (np.int64(squared[i]) << 32) | np.int64(order[first + i])
                keys[found] = key
                found += int(key < limit)
            if found >= full:
                _sort(keys, found, spare, ends, value, bits)
                found, full, limit = k, room, keys[k - 1]
                bits[0] = limit >> 32
                bound = value[0]
        _sort(keys, found, spare, ends, value, bits)
        for j in range(k):
            bits[0] = keys[j] >> 32
            distance[row, j] = np.sqrt(value[0])
            index[row, j] = keys[j] & 0xFFFFFFFF


@compiled
def _farthest(index: Array, x: Any, y: Any, z: Any, points: Array, place: Array) -> Any:
    """Squared distance of the farthest of some samples."""
    farthest = np.float32(0)
    for i in index:
        dx, dy = points[0, place[i]] - x, points[1, place[i]] - y
        dz = points[2, place[i]] - z
        farthest = max(farthest, dx * dx + dy * dy + dz * dz)
    return farthest


@compiled
def _outside(box: Array, x: Any, y: Any, z: Any) -> Any:
    """Squared distance from a box."""
    nil = np.float32(0)
    dx = max(max(box[0] - x, x - box[3]), nil)
    dy = max(max(box[1] - y, y - box[4]), nil)
    dz = max(max(box[2] - z, z - box[5]), nil)
    return dx * dx + dy * dy + dz * dz


@compiled
def _sort(keys: Array, count: int, spare: Array, ends: Array, value: Array, bits: Array) -> None:
    """Sorts the first keys. The squared distances of samples on a surface are spread evenly, so
    that most are in their places once they have been dealt out by size."""
    least, largest = keys[0], keys[0]
    for i in range(1, count):
        least, largest = min(least, keys[i]), max(largest, keys[i])
    bits[0], bits[1] = least >> 32, largest >> 32
    low, high = value[0], value[1]
    if count > _FEW and low < high:
        scale = np.float32(count - 1) / (high - low)
        ends[: count + 1] = 0
        for i in range(count):
            bits[0] = keys[i] >> 32
            ends[int((value[0] - low) * scale) + 1] += 1
            spare[i] = keys[i]
        for i in range(count):
            ends[i + 1] += ends[i]
        for i in range(count):
            bits[0] = spare[i] >> 32
            pile = int((value[0] - low) * scale)
            keys[ends[pile]] = spare[i]
            ends[pile] += 1
    for i in range(1, count):
        key, j = keys[i], i
        while j > 0 and keys[j - 1] > key:
            keys[j] = keys[j - 1]
            j -= 1
        keys[j] = key
