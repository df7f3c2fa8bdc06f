"""Nearest neighbours among the samples, by a KD-tree on the CPU whatever the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

_WORKERS = 2  # threads of a look-up; more than two cores bring little at these sizes


@dataclass(frozen=True)
class Neighbours:
    """Answer of a k-nearest look-up, nearest first.

    Attributes:
        distance: (n, k) float32.
        index: (n, k) int64 into the samples.
    """

    distance: Tensor
    index: Tensor


class NeighbourTree:
    """A KD-tree over (m, 3) samples."""

    def __init__(self, samples: Tensor | NDArray[np.floating]) -> None:
        array = samples.cpu().numpy() if isinstance(samples, Tensor) else samples
        self._tree = cKDTree(array, compact_nodes=False, balanced_tree=False)
        self.size = len(array)

    def nearest(self, queries: Tensor, k: int) -> Neighbours:
        """The k nearest samples of (n, 3) queries, fewer where there are fewer samples."""
        k = min(k, self.size)
        distance, index = self._tree.query(
            queries.detach().cpu().numpy(), k=list(range(1, k + 1)), workers=_WORKERS
        )
        return Neighbours(
            torch.from_numpy(distance.astype(np.float32)).to(queries.device),
            torch.from_numpy(index.astype(np.int64)).to(queries.device),
        )
