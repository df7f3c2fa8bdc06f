"""Progress as a value: long computations yield it, callers decide what to do with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Stage = Literal["reading", "fitting", "densifying", "extracting", "exporting"]
STAGES: tuple[Stage, ...] = ("reading", "fitting", "densifying", "extracting", "exporting")


@dataclass(frozen=True)
class GrownCloud:
    """The densified cloud so far.

    Attributes:
        points: (n, 3) float64, frame and units of the upload; the measured points first.
        rounds: (n,) int64, the round that added each point, 0 for measured ones.
    """

    points: NDArray[np.float64]
    rounds: NDArray[np.int64]


@dataclass(frozen=True)
class CoarseMesh:
    """A quick mesh of the last finished fit.

    Attributes:
        vertices: (v, 3) float64, frame and units of the upload.
        faces: (f, 3) int64.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


class Look(Protocol):
    """A look into a reconstruction under way. What it costs is spent by the one who looks.

    Good until the next step is asked for.
    """

    @property
    def fits(self) -> int:
        """Finished fits so far: with a new one there is a new mesh to see."""

    def cloud(self) -> GrownCloud:
        """The densified cloud so far."""

    def mesh(self, resolution: int) -> CoarseMesh | None:
        """The surface of the last finished fit; None before there is one, or if it is empty.

        resolution: cells along the largest extent.
        """


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
        look: what can be seen of it now; None where there is nothing to see.
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
    look: Look | None = field(default=None, repr=False, compare=False)
