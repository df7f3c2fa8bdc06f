"""Seconds left, once that can be told."""

from __future__ import annotations

_EARLIEST_S = 1.5
_EARLIEST_FRACTION = 0.05
_TOLERANCE = 0.25  # relative; guesses that differ by more are not yet stable
_STEADY = 5  # that many guesses in a row must agree
_WEIGHT = 0.2  # of the newest guess in the running mean


class TimeLeft:
    """Estimates the whole duration from the time taken so far, smoothed.

    `update` answers None until a few guesses in a row agree.
    """

    def __init__(self) -> None:
        self._total_s: float | None = None
        self._agreeing = 0

    def update(self, elapsed_s: float, fraction: float) -> float | None:
        """fraction: of the whole work, 0..1. Seconds left or None."""
        if elapsed_s < _EARLIEST_S or fraction < _EARLIEST_FRACTION:
            return None
        guess = elapsed_s / fraction
        mean = guess if self._total_s is None else self._total_s
        agrees = abs(guess - mean) <= _TOLERANCE * mean
        self._agreeing = self._agreeing + 1 if agrees else 0
        self._total_s = mean + _WEIGHT * (guess - mean)
        if self._agreeing < _STEADY:
            return None
        return round(max(0.0, self._total_s - elapsed_s), 1)
