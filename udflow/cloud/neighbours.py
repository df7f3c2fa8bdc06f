"""Nearest neighbours among the samples, on the CPU whatever the device: see `tree_loops`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from udflow.cloud.tree_loops import build_tree, levels_of, nearest_rows
from udflow.compiled import over_rows


@dataclass(frozen=True)
class Neighbours:
    """Answer of a k-nearest look-up, nearest first.

    Attributes:
        distance: (n, k) float32.
        index: (n, k) int64 into the samples.
    """

    distance: Tensor
    index: Tensor

    @property
    def spacing(self) -> Tensor:
        """(n,) distance between samples on the surface around each query, if that is a sample."""
        # one sample per a^2 puts the sixth neighbour at about 1.3 a
        return self.distance[:, min(6, self.distance.shape[1] - 1)] / 1.3


class NeighbourTree:
    """A KD-tree over (m, 3) finite samples, in single precision."""

    def __init__(self, samples: Tensor | NDArray[np.floating]) -> None:
        array = samples.detach().cpu().numpy() if isinstance(samples, Tensor) else samples
        self.size = len(array)
        points = np.array(_finite(array).T, np.float32, order="C")
        order, levels = np.arange(self.size, dtype=np.int32), levels_of(self.size)
        boxes = np.empty((2 ** (levels + 1) - 1, 6), np.float32)
        if self.size > 0:
            build_tree(points, order, levels, boxes)
        place = np.empty(self.size, np.int32)
        place[order] = np.arange(self.size, dtype=np.int32)
        self._tree = points, order, place, levels, boxes

    def nearest(self, queries: Tensor, k: int) -> Neighbours:
        """The k nearest samples of (n, 3) finite queries, fewer where there are fewer samples."""
        k = min(k, self.size)
        places = np.ascontiguousarray(_finite(queries.detach().cpu().numpy()), np.float32)
        distance = np.empty((len(places), k), np.float32)
        index = np.empty((len(places), k), np.int64)
        if k > 0:
            over_rows(nearest_rows, len(places), places, *self._tree, distance, index)
        return Neighbours(
            torch.from_numpy(distance).to(queries.device),
            torch.from_numpy(index).to(queries.device),
        )


def _finite(places: NDArray[np.floating]) -> NDArray[np.floating]:
    if not np.isfinite(places).all():
        raise ValueError("A place to look for neighbours at is not a finite number.")
    return places
