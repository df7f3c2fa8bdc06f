"""What blended quadrics miss of their own sites, given back to them.

Every smoother flattens what it smooths. What it leaves of the data, smoothed likewise and added,
takes much of that back ("twicing", Tukey 1977; boosting, Bühlmann and Yu 2003), and adds noise
where the data are noisy. So it is done where the widths say that there is hardly any: where few
neighbours predicted best around most sites.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from udflow.cloud.quadric_surface import UNWIDENED, QuadricSurface
from udflow.cloud.quadrics import LocalQuadrics
from udflow.cloud.sites import Sites

_ROUNDS = 2
_AROUND = 96  # sites around of which most must have so few
_LARGEST = 0.3  # spacings: who misses its site by more has found another piece of surface


def nearer_to_sites(quadrics: LocalQuadrics, sites: Sites) -> LocalQuadrics:
    """The quadrics, moved along their normals by what their blend misses of their sites."""
    clean = sites.mean((quadrics.count <= UNWIDENED).float(), _AROUND) > 0.5
    if not bool(clean.any()):
        return quadrics
    surface = QuadricSurface.of(quadrics)
    for _ in range(_ROUNDS):
        missed = quadrics.origin - surface.project(quadrics.origin)
        height = (missed * quadrics.frame[:, 2]).sum(dim=1)
        sure = clean & (height.abs() < _LARGEST * quadrics.spacing)
        coefficients = quadrics.coefficients.clone()
        coefficients[:, 0] += torch.where(sure, height / quadrics.radius, 0.0)
        quadrics = replace(quadrics, coefficients=coefficients)
        surface = QuadricSurface(quadrics, surface.tree)
    return quadrics
