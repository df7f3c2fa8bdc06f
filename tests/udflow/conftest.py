"""A fitted field that several tests look at from different sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from shapes import Shape, Sphere

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, ExtractConfig
from udflow.fields.spline import SplineField
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.fit.spline import SplineFit, fit_spline


@dataclass(frozen=True)
class Fitted:
    """A shape's samples and the field fitted to them, unit frame."""

    surface: SampledSurface
    fit: SplineFit

    @property
    def field(self) -> SplineField:
        return self.fit.field

    def placed(self, normalisation: Normalisation) -> UnsignedDistanceField:
        """The field in a world frame."""
        return UnsignedDistanceField(self.fit.field, self.surface.surface, normalisation)


FitShape = Callable[..., Fitted]


def fitted(shape: Shape, count: int = 2000, config: Config | None = None) -> Fitted:
    """A small fit of a shape: about a second."""
    config = config or Config(extract=ExtractConfig(resolution=40))
    with torch.inference_mode():
        surface = SampledSurface.of(shape.sample(count))
        steps = fit_spline(surface, config)
        while True:
            try:
                next(steps)
            except StopIteration as done:
                return Fitted(surface, done.value)


@pytest.fixture(scope="session")
def fit_shape() -> FitShape:
    """The function `fitted`."""
    return fitted


@pytest.fixture(scope="session")
def fitted_sphere() -> Fitted:
    """A sphere of radius 1/2."""
    return fitted(Sphere(), 1500, Config(extract=ExtractConfig(resolution=24)))


@pytest.fixture(scope="session")
def sphere_field(fitted_sphere: Fitted) -> UnsignedDistanceField:
    """The same, 250 units wide, somewhere in UTM zone 32."""
    return fitted_sphere.placed(Normalisation((512345.5, 5403210.25, 312.0), 250.0))
