"""What a field must offer to densification, extraction and distance queries."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import Tensor

from udflow.cloud.neighbours import NeighbourTree


@runtime_checkable
class ProjectiveField(Protocol):
    """Anything that moves points onto the surface it represents.

    Distance and gradient follow: with the foot y = project(x), distance(x) = |x - y| and
    gradient(x) = (x - y) / |x - y|, equation (5).
    """

    def project(self, points: Tensor) -> Tensor:
        """Feet of points.

        Args:
            points: (n, 3) float32, unit frame.

        Returns:
            (n, 3) float32 points on the surface, unit frame, same device.
        """
        ...


@runtime_checkable
class DistanceField(Protocol):
    """Anything with an unsigned distance and its gradient: all that densification asks for."""

    def distance(self, points: Tensor) -> Tensor:
        """Unsigned distances of (n, 3) points from the surface, (n,), unit frame."""
        ...

    def gradient(self, points: Tensor) -> Tensor:
        """Their gradients, (n, 3), of any length; away from the surface."""
        ...


@runtime_checkable
class EndingField(ProjectiveField, Protocol):
    """A field that knows more exactly where trajectories end than it can say at every place."""

    def ends(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Ends (n, 3) of trajectories that have come to (n, 3) points of the surface, and (n,)
        bool, where they are sure; other ends are of no use."""
        ...


class FittedField(ProjectiveField, Protocol):
    """A field that was fitted to a cloud and knows where it can be trusted."""

    @property
    def solved(self) -> bool:
        """Whether it was solved for the feet on the quadrics, which then are what it means."""
        ...

    @property
    def half_edge(self) -> float:
        """Half the edge of the box in which it answers, unit frame."""
        ...

    def refine(self, points: Tensor) -> Tensor:
        """(n, 3) points that are already near the surface to their feet."""
        ...

    def answers(self, points: Tensor, sites: NeighbourTree) -> tuple[Tensor, Tensor]:
        """Feet of (n, 3) points, and (n,) bool, where the field can be trusted alone; other feet
        are of no use.

        sites: points that are known to be on the surface.
        """
        ...
