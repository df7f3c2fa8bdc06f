"""The samples around sites, and what quadrics explain of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.cloud.neighbours import Neighbours
from udflow.cloud.quadrics import LocalQuadrics, heights_over
from udflow.cloud.sites import Sites


@dataclass(frozen=True)
class Neighbourhoods:
    """The k samples nearest to each of d sites.

    Attributes:
        near: where they are among the samples.
        points: (d, k, 3).
        weights: (d, k) by nearness.
        tolerance: (d,) distance from a quadric up to which a sample is explained by it.
    """

    near: Neighbours
    points: Tensor
    weights: Tensor
    tolerance: Tensor

    @classmethod
    def of(cls, sites: Sites, rows: Tensor, tolerance: Tensor, k: int) -> Neighbourhoods:
        """Those of some of the sites, given the tolerances (n,) of all."""
        near = Neighbours(sites.near.distance[rows, :k], sites.near.index[rows, :k])
        weights = torch.exp(-(near.distance / near.distance[:, -1:].clamp_min(1e-12)).square())
        return cls(near, sites.samples[near.index], weights, tolerance[rows])

    def explained(self, quadrics: LocalQuadrics) -> tuple[Tensor, Tensor]:
        """How much of each neighbourhood its quadric, one of d, explains, (d,), 0 if it misses the
        site; and which samples, (d, k) bool."""
        off = heights_over(quadrics, self.points).abs() / self.tolerance[:, None]
        score = ((1 - off.square()).clamp_min(0) * self.weights).sum(dim=1)
        return torch.where(off[:, 0] < 1, score, 0.0), off < 1

    def best(self, quadrics: LocalQuadrics, own: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
        """Which of all quadrics explains most of each neighbourhood, (d,), and how much.

        Args:
            quadrics: all of them.
            own: (d,) index of that which is taken where no other is better.
            others: (d, h) indices of the others.
        """
        chosen, most = own, self.explained(quadrics[own])[0]
        for candidate in others.unbind(dim=1):
            score = self.explained(quadrics[candidate])[0]
            chosen = torch.where(score > most, candidate, chosen)
            most = torch.maximum(most, score)
        return chosen, most
