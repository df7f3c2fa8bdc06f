"""The sites of quadrics and what lies near them, looked up no more often than needed."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from udflow.cloud.fit_loops import sum_up_rows
from udflow.cloud.fits import Fits, fit_nearest
from udflow.cloud.neighbours import Neighbours, NeighbourTree
from udflow.compiled import over_rows

NARROW = 10  # neighbours of the first fits, by which the noise is judged
NEAR = 40  # samples looked up for each site, at least
_QUARTILE = 3.14  # standard deviations of noise in the lower quartile of its absolute values


class Sites:
    """Where quadrics are fitted, and to what.

    Attributes:
        origin: (n, 3) the sites, unit frame.
        samples: (m, 3) distinct points, the data.
        tree: the tree of the samples.
    """

    def __init__(self, origin: Tensor, samples: Tensor, tree: NeighbourTree) -> None:
        self.origin, self.samples, self.tree = origin, samples, tree
        self._are_samples = origin is samples
        self._tree = tree if self._are_samples else NeighbourTree(origin)
        self._around: Tensor | None = None  # without distances, which nobody asks for
        self._near: Neighbours | None = None

    def around(self, k: int) -> Tensor:
        """(n, k or more) int64 the nearest sites of each; all, if there are fewer."""
        if self._around is None or self._around.shape[1] < min(k, self._tree.size):
            found = self._tree.nearest(self.origin, k)
            self._around = found.index
            if self._are_samples:
                self._near = found
        return self._around

    @property
    def near(self) -> Neighbours:
        """The nearest samples of each site, `NEAR` or more; all, if there are fewer."""
        if self._are_samples:
            self.around(NEAR)
        if self._near is None:
            self._near = self.tree.nearest(self.origin, NEAR)
        return self._near

    @cached_property
    def narrow(self) -> Fits:
        """Quadrics fitted to the `NARROW` nearest samples."""
        return fit_nearest(self.samples, self.origin, self.near, NARROW)

    def mean(self, values: Tensor, k: int, rows: Tensor | None = None) -> Tensor:
        """Means of the sites' values (n,) over the k sites around each, or around some of them."""
        return self._sum_up(values, k, rows, -1.0)

    def noise(self, errors: Tensor, k: int, rows: Tensor | None = None) -> Tensor:
        """Standard deviations of the noise around each site, or around some of them: by the lower
        quartile of the held-back errors (n,) of k sites, which does not see the creases."""
        return _QUARTILE * self._sum_up(errors, k, rows, 0.25)

    def _sum_up(self, values: Tensor, k: int, rows: Tensor | None, share: float) -> Tensor:
        around = self.around(k)
        if rows is None:
            rows = torch.arange(len(around), device=around.device)
        by = sum_up_by_loop if values.device.type == "cpu" else sum_up_by_tensors
        return by(values, rows, around, min(k, around.shape[1]), share)


def sum_up_by_loop(values: Tensor, rows: Tensor, around: Tensor, k: int, share: float) -> Tensor:
    """Means, or quantiles if share is not negative, of values (n,) over the first k sites around
    (n, k or more) some of them (rows), on the CPU."""
    result = torch.empty(len(rows))
    arrays = (values.contiguous(), rows, around)
    over_rows(sum_up_rows, len(rows), *(a.numpy() for a in arrays), k, share, result.numpy())
    return result


def sum_up_by_tensors(values: Tensor, rows: Tensor, around: Tensor, k: int, share: float) -> Tensor:
    """The same on any device."""
    found = values[around[rows, :k]]
    return found.mean(dim=1) if share < 0 else found.quantile(share, dim=1)
