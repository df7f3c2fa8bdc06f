"""Small fits of exact shapes, each made once a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from shapes import Shape

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, ExtractConfig
from udflow.fields.spline import SplineField
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.fit.spline import SplineFit, fit_spline

UNIT = Normalisation((0.0, 0.0, 0.0), 1.0)
SMALL = Config(extract=ExtractConfig(resolution=24))
MEDIUM = Config(extract=ExtractConfig(resolution=40))


@dataclass(frozen=True)
class Fitted:
    """What samples describe and the field fitted to it, unit frame."""

    surface: SampledSurface
    fit: SplineFit

    @property
    def field(self) -> SplineField:
        return self.fit.field

    def placed(self, normalisation: Normalisation = UNIT) -> UnsignedDistanceField:
        """The field in a world frame."""
        return UnsignedDistanceField(self.field, self.surface.surface, normalisation)


def fit(surface: SampledSurface, config: Config = SMALL) -> Fitted:
    """The fit of a surface, run to its end."""
    with torch.inference_mode():
        steps = fit_spline(surface, config)
        while True:
            try:
                next(steps)
            except StopIteration as done:
                return Fitted(surface, done.value)


@cache
def fitted(shape: Shape, count: int = 2000, config: Config = MEDIUM) -> Fitted:
    """The fit of samples of a shape: about a second."""
    with torch.inference_mode():
        surface = SampledSurface.of(shape.sample(count))
    return fit(surface, config)
