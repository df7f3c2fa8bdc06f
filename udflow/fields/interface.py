"""What a field must offer to densification and extraction."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor


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
