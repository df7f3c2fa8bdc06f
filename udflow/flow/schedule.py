"""The paper's time schedule: steps that grow with the distance from the surface."""

from __future__ import annotations

from dataclasses import dataclass

from udflow.errors import InvalidConfig


@dataclass(frozen=True)
class TimeSchedule:
    """t_k = k(k+1) / (K(K+1)) and dt_k = 2k / (K(K+1)) for k = 1..K (section III-B).

    t_0 = 0 is the surface, t_K = 1 the query; t_k - t_{k-1} = dt_k and the dt_k sum to 1.

    Attributes:
        steps: K >= 1.

    Raises:
        InvalidConfig: K < 1.
    """

    steps: int

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InvalidConfig(f"flow.steps is {self.steps}; choose K >= 1 steps (paper: 5)")

    def time(self, k: int) -> float:
        """t_k for 0 <= k <= K."""
        return k * (k + 1) / (self.steps * (self.steps + 1))

    def step(self, k: int) -> float:
        """dt_k for 1 <= k <= K."""
        return 2 * k / (self.steps * (self.steps + 1))

    @property
    def times(self) -> tuple[float, ...]:
        """(t_1, ..., t_K), the times at which velocities are trained and asked for."""
        return tuple(self.time(k) for k in range(1, self.steps + 1))
