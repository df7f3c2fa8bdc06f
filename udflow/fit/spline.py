"""Fitting a SplineField: grids from the samples' spacing, one linear solve per level."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.cloud.sampled_surface import SampledSurface
from udflow.config import Config, SplineConfig
from udflow.fields.lattice import SparseLattice, occupied_mask
from udflow.fields.spline import SplineField, SplineGrid, SplineLevel
from udflow.fit.linear import solve_level
from udflow.flow.schedule import TimeSchedule

BOX = 1.5  # half edge of the trained box: three times the cloud's largest extent
_DILATION = 2  # cells around the samples' cells that may belong to a band
_SPARSE_CELLS = 2.5  # local spacing, in cells, that is too wide for a level
_SPARSE = 2.5  # local spacing, in median spacings, that is too wide for the finest level
_BAND = 1.75  # half width of a band in cells
_CELL_PER_SPACING = 0.65  # edge of a cell where there are many samples
_FINE_CELL_PER_SPACING = 0.5  # where there are few: finer cells follow the quadrics more closely
_FINE_RESOLUTION = 144  # and cost nothing below this resolution
_SMOOTHNESS = 1e-2
_COARSEST = 8  # cells along the largest extent: no level is coarser, the whole box is no finer


@dataclass(frozen=True)
class SplineFit:
    """A fitted field.

    Attributes:
        field: the field.
        loss: equation (3): mean over times of || v(x_t, t) - (x_1 - x_0) ||^2 at the trained
            states, unit frame.
    """

    field: SplineField
    loss: float


def finest_resolution(spacing: float, config: Config) -> int:
    """Cells of the finest grid along the largest extent.

    A little finer than the samples, because finer cannot be known; no finer than the mesh asked
    for, because finer cannot be seen.
    """
    if config.spline.resolution is not None:
        return config.spline.resolution
    coarse = 1.0 / (_CELL_PER_SPACING * spacing)
    fine = min(1.0 / (_FINE_CELL_PER_SPACING * spacing), _FINE_RESOLUTION)
    return int(min(max(coarse, fine, 16), config.extract.resolution, 512))


def fit_spline(surface: SampledSurface, config: Config) -> Generator[int, None, SplineFit]:
    """Solves the levels from coarse to fine; yields the number solved so far, returns the fit."""
    schedule = TimeSchedule(config.flow.steps)
    finest = finest_resolution(surface.spacing, config)
    levels: list[SplineLevel] = []
    loss = 0.0
    for k in range(schedule.steps, 0, -1):
        grid, displacement = trajectories(surface, schedule, k, finest)
        fit = solve_level(grid, displacement, smoothness(config.spline), surface.error)
        levels.insert(0, fit.level)
        loss += fit.residual / schedule.time(k) ** 2 / schedule.steps
        yield len(levels)
    return SplineFit(SplineField(schedule, tuple(levels)), loss)


def smoothness(config: SplineConfig) -> float:
    """Weight of the third differences."""
    return _SMOOTHNESS if config.smoothness is None else config.smoothness


def trajectories(
    surface: SampledSurface, schedule: TimeSchedule, k: int, finest: int
) -> tuple[SplineGrid, Tensor]:
    """States at t_k and what they owe to the surface.

    Returns:
        The grid of t_k, whose cell centres x are the states, and x - x_0 for each, (c, 3). Cells
        grow in proportion to t_k, so that a level's band holds the states at t_k of all
        trajectories that start in the coarsest band.
    """
    grid = _candidates(surface, schedule, k, finest)
    centres = grid.centres()
    displacement = centres - surface.project(centres)
    near = displacement.norm(dim=1) <= _BAND * grid.spacing
    if k == schedule.steps:
        near.fill_(True)
    cells = SparseLattice.from_distinct(grid.cells.coordinates[near], grid.cells.shape)
    return SplineGrid(grid.origin, grid.spacing, cells, cells.dilated(1)), displacement[near]


def _candidates(surface: SampledSurface, schedule: TimeSchedule, k: int, finest: int) -> SplineGrid:
    """Cells around the samples; samples too far apart for these cells wait for a coarser level."""
    quadrics = surface.surface.quadrics
    sites = quadrics.origin
    whole_box = k == schedule.steps
    growth = schedule.time(k) / schedule.time(1)
    spacing = 1.0 / (_COARSEST if whole_box else max(finest / growth, _COARSEST))
    extent = BOX if whole_box else float(sites.abs().max())
    half = extent + (_DILATION + 2) * spacing
    points = int(2 * half / spacing) + 2
    shape = (points, points, points)
    origin = sites.new_full((3,), -0.5 * (points - 1) * spacing)
    if whole_box:
        mask = torch.zeros(shape, dtype=torch.bool, device=sites.device)
        mask[1:-1, 1:-1, 1:-1] = True
        cells = SparseLattice.from_mask(mask)
    else:
        dense = sites[quadrics.spacing <= max(_SPARSE_CELLS * spacing, _SPARSE * surface.spacing)]
        nearest = ((dense - origin) / spacing).round().long()
        cells = SparseLattice.from_mask(occupied_mask(nearest, shape)).dilated(_DILATION)
    return SplineGrid(origin, spacing, cells, cells)
