"""What blended quadrics miss of their own sites, given back to them.

Every smoother flattens what it smooths. What it leaves of the data, smoothed likewise and added,
takes much of that back ("twicing", Tukey 1977; boosting, Bühlmann and Yu 2003). Where the widths
say that there is hardly any noise, since few neighbours predicted best around most sites, each site
gets back what is missed of it alone. Elsewhere that is averaged over as many sites as the fit was,
and given back as far as it is more than noise: shrunk as James and Stein (1961) do, by what the
sites around have in common.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from udflow.cloud.quadric_surface import UNWIDENED, QuadricSurface
from udflow.cloud.quadrics import FALLOFF, LocalQuadrics
from udflow.cloud.sites import Sites

_ROUNDS = 2
_AROUND = 96  # sites that are looked at around each
_SPACINGS = 0.3  # a blend that misses its site by more than so many spacings
_ERRORS = 3.0  # and so many held-back errors has found another piece of surface
_ALONG = 0.5  # cosine between normals of sites on one piece of surface
_NOISE = 0.25  # of the variance that unsmoothed noise would leave, what it leaves after a fit
_CHUNK = 1 << 14  # sites averaged together: bounds memory


def nearer_to_sites(quadrics: LocalQuadrics, sites: Sites) -> LocalQuadrics:
    """The quadrics, moved along their normals by what their blend misses of the sites around."""
    clean = sites.mean((quadrics.count <= UNWIDENED).float(), _AROUND) > 0.5
    limit = torch.maximum(_SPACINGS * quadrics.spacing, _ERRORS * quadrics.error)
    surface = QuadricSurface.of(quadrics)
    for _ in range(_ROUNDS):
        missed = quadrics.origin - surface.project(quadrics.origin)
        height = (missed * quadrics.frame[:, 2]).sum(dim=1)
        height = torch.where(height.abs() < limit, height, 0.0)
        if not bool(clean.all()):
            height = torch.where(clean, height, _more_than_noise(height, clean, quadrics, sites))
        coefficients = quadrics.coefficients.clone()
        coefficients[:, 0] += height / quadrics.radius
        quadrics = replace(quadrics, coefficients=coefficients)
        surface = QuadricSurface(quadrics, surface.tree)
    return quadrics


def _more_than_noise(
    height: Tensor, clean: Tensor, quadrics: LocalQuadrics, sites: Sites
) -> Tensor:
    """Heights (n,) along the sites' own normals, averaged over the sites around those that are not
    clean (n,), and shrunk by the noise."""
    mean, variance = torch.zeros_like(height), torch.ones_like(height)
    for rows in (~clean).nonzero().squeeze(1).split(_CHUNK):
        mean[rows], weight = _averaged(height, rows, quadrics, sites)
        variance[rows] = _NOISE * quadrics.error[rows].square() * weight
    excess = sites.mean(mean.square() / variance.clamp_min(1e-20), _AROUND)
    return mean * (1 - 1 / excess.clamp_min(1e-9)).clamp_min(0.0)


def _averaged(
    height: Tensor, rows: Tensor, quadrics: LocalQuadrics, sites: Sites
) -> tuple[Tensor, Tensor]:
    """Means of heights around some sites, over as many as their quadrics were fitted to samples,
    on the same piece of surface; and the sums of squares of their weights."""
    index, normal = sites.around(_AROUND)[rows], quadrics.frame[:, 2]
    distance = (quadrics.origin[index] - quadrics.origin[rows, None]).norm(dim=2)
    last = quadrics.count[rows, None].clamp_max(index.shape[1]) - 1
    cosine = (normal[index] * normal[rows, None]).sum(dim=2)
    weight = torch.exp(-FALLOFF * (distance / distance.gather(1, last)).square())
    weight = weight * (cosine.abs() > _ALONG)
    weight = weight * (torch.arange(index.shape[1], device=rows.device) <= last)
    weight = weight / weight.sum(dim=1, keepdim=True)
    return (weight * height[index] * cosine.sign()).sum(dim=1), weight.square().sum(dim=1)
