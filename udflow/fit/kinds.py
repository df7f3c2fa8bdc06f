"""Fits of all kinds behind one face: the configuration says which."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

import torch
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config
from udflow.fields.interface import FittedField
from udflow.fit.neural import NeuralFitting, iterations_of
from udflow.fit.spline import SplineFit, fit_spline


class Fit(Protocol):
    """A fitted field and its loss, equation (3)."""

    @property
    def field(self) -> FittedField:
        """The field."""
        ...

    @property
    def loss(self) -> float:
        """Mean squared trajectory residual, unit frame."""
        ...


class Fitting(Protocol):
    """A fit under way."""

    @property
    def total(self) -> int:
        """Steps that it takes."""
        ...

    def run(self) -> Generator[int, None, Fit]:
        """Yields the number of steps done; returns the fit."""
        ...

    def early(self) -> Fit | None:
        """What there is before the end; None where a fit cannot be used before it is whole."""
        ...


class SplineFitting:
    """The linear solves, one step per level."""

    def __init__(self, surface: SampledSurface, config: Config) -> None:
        self._surface, self._config = surface, config
        self.total = config.flow.steps

    def run(self) -> Generator[int, None, SplineFit]:
        """Yields the number of levels solved; returns the fit."""
        return (yield from fit_spline(self._surface, self._config))

    def early(self) -> None:
        """A field with levels missing answers nowhere."""
        return


def fitting_of(
    samples: Tensor,
    surface: SampledSurface,
    config: Config,
    number: int,
    rounds: int,
    earlier: Fit | None,
    generator: torch.Generator,
) -> SplineFitting | NeuralFitting:
    """A fit to P^n, ready to run.

    Args:
        samples: P^n, (n, 3), unit frame.
        surface: quadrics of the measured points.
        config: kind and parameters of the field.
        number: n, the rounds of densification so far.
        rounds: planned in all.
        earlier: the fit to P^{n-1}, where trained fields go on from.
        generator: source of randomness, on the CPU.
    """
    if config.field == "spline":
        return SplineFitting(surface, config)
    parameters = getattr(earlier.field, "parameters", None) if earlier is not None else None
    iterations = iterations_of(number, rounds, config)
    return NeuralFitting(
        samples, surface, config, iterations, parameters, generator, first=number == 0
    )
