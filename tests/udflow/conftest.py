"""A fitted field that several tests look at from different sides."""

from __future__ import annotations

import pytest
from fits import SMALL, Fitted, fitted
from shapes import Sphere

from udflow.cloud.normalisation import Normalisation
from udflow.fields.unsigned import UnsignedDistanceField


@pytest.fixture
def fitted_sphere() -> Fitted:
    """A sphere of radius 1/2."""
    return fitted(Sphere(), 1500, SMALL)


@pytest.fixture(scope="session")
def sphere_field() -> UnsignedDistanceField:
    """The same, 250 units wide, somewhere in UTM zone 32."""
    normalisation = Normalisation((512345.5, 5403210.25, 312.0), 250.0)
    return fitted(Sphere(), 1500, SMALL).placed(normalisation)
