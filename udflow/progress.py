"""Progress as a value: long computations yield it, callers decide what to do with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Stage = Literal["reading", "fitting", "densifying", "extracting", "exporting"]
STAGES: tuple[Stage, ...] = ("reading", "fitting", "densifying", "extracting", "exporting")


@dataclass(frozen=True)
class Progress:
    """One moment of a reconstruction.

    Attributes:
        stage: what is being done.
        step, total: position inside the stage, 0 <= step <= total.
        fraction: position inside the whole reconstruction, 0..1, never falling.
        elapsed_s: seconds since the start.
        points: points of the (densified) cloud so far.
        round, rounds: densification round, 0 where there is none.
        loss: mean squared trajectory residual of the last fit, equation (3), in unit-cube lengths
            squared; None before the first fit.
    """

    stage: Stage
    step: int
    total: int
    fraction: float
    elapsed_s: float
    points: int
    round: int = 0
    rounds: int = 0
    loss: float | None = None
