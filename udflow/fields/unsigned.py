"""The unsigned distance field in the units and frame of the upload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from udflow.cloud.normalisation import Normalisation
from udflow.cloud.quadric_surface import QuadricSurface
from udflow.errors import InvalidQuery
from udflow.fields.interface import FittedField

_CHUNK = 1 << 18
_SAME = 0.2  # spacings that a fitted field and quadrics may differ by where both are right
_WIDEST = 8.0  # half edges from the centre: farther away all sites are as near in single precision
_PLACE = 0.04  # unit lengths: queries in one cube of this size are answered one after the other


@dataclass(frozen=True)
class FieldAnswer:
    """Answers to n queries, world frame and units.

    Attributes:
        distance: (n,) float64, >= 0.
        gradient: (n, 3) float32 unit vectors pointing away from the surface; zero on it.
        closest: (n, 3) float64 points of the surface.
        valid: (n,) bool, whether the query lies in the trained box. Outside it the nearest quadric
            answers; beyond eight times the box the foot is that of the nearest point of those
            eight boxes, right to a thousandth of the distance.
    """

    distance: NDArray[np.float64]
    gradient: NDArray[np.float32]
    closest: NDArray[np.float64]
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class SurfaceField:
    """A fitted field and quadrics as one `ProjectiveField` in the unit frame.

    Near the surface the fitted field answers. A smooth energy blurs the places that are equally
    far from two parts of the surface, and a network knows little of places where it was hardly
    trained, so farther away the nearest quadric gives the foot and the field refines it.
    """

    fitted: FittedField
    surface: QuadricSurface

    def project(self, points: Tensor) -> Tensor:
        """Feet of (n, 3) points."""
        feet, trusted = self.fitted.answers(points, self.surface.tree)
        far = (~trusted).nonzero().squeeze(1)
        if len(far) > 0:
            feet[far] = self.fitted.refine(self.surface.project(points[far]))
        return feet

    def ends(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Ends (n, 3) of trajectories that have come to (n, 3) points of the surface, and (n,)
        bool, where they are sure.

        A solved field means the feet on the quadrics and comes near them. Where the data are
        clean and both hardly differ, they are its surface.
        """
        if not self.fitted.solved:
            return points, torch.zeros(len(points), dtype=torch.bool, device=points.device)
        feet, clean, spacing = self.surface.sure_feet(points)
        return feet, clean & ((feet - points).norm(dim=1) < _SAME * spacing)


@dataclass(frozen=True)
class UnsignedDistanceField:
    """A fitted field that answers in world units.

    Attributes:
        fitted: the field in the unit frame.
        surface: quadrics of the measured points, unit frame.
        normalisation: between world and unit frame.
    """

    fitted: FittedField
    surface: QuadricSurface
    normalisation: Normalisation

    @property
    def unit(self) -> SurfaceField:
        """The same field in the unit frame."""
        return SurfaceField(self.fitted, self.surface)

    @property
    def low(self) -> NDArray[np.float64]:
        """Lower corner of the trained box, world frame, (3,)."""
        return np.asarray(self.normalisation.centre) - self._half_edge()

    @property
    def high(self) -> NDArray[np.float64]:
        """Upper corner of the trained box, world frame, (3,)."""
        return np.asarray(self.normalisation.centre) + self._half_edge()

    def query(self, points: NDArray[np.floating]) -> FieldAnswer:
        """Distance, gradient and closest point of (n, 3) world points.

        Raises:
            InvalidQuery: not (n, 3), or a coordinate is not finite; the message names the row.
        """
        points = checked_queries(points)
        parts = [self._query(points[i : i + _CHUNK]) for i in range(0, max(len(points), 1), _CHUNK)]
        return FieldAnswer(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("distance", "gradient", "closest", "valid")
            )
        )

    def _query(self, points: NDArray[np.float64]) -> FieldAnswer:
        device = self.surface.quadrics.origin.device
        valid: NDArray[np.bool_] = np.all((points >= self.low) & (points <= self.high), axis=1)
        centre, reach = np.asarray(self.normalisation.centre), _WIDEST * self._half_edge()
        clipped = np.clip(points, centre - reach, centre + reach)
        unit = torch.from_numpy(self.normalisation.to_unit(clipped))
        with torch.inference_mode():
            order = _by_place(unit)
            feet = torch.empty_like(unit)
            feet[order] = self.unit.project(unit[order].to(device)).cpu()
        closest = self.normalisation.to_world(feet.numpy())
        offset = points - closest
        distance = np.linalg.norm(offset, axis=1)
        gradient = offset / np.maximum(distance, np.finfo(np.float64).tiny)[:, None]
        return FieldAnswer(distance, gradient.astype(np.float32), closest, valid)

    def _half_edge(self) -> float:
        return self.fitted.half_edge * self.normalisation.scale


def _by_place(points: Tensor) -> Tensor:
    """An order of (n, 3) points in which neighbours follow each other: what one needs is then
    still in the cache for the next."""
    x, y, z = (points / _PLACE).round().long().unbind(dim=1)
    return torch.argsort((x * 1024 + y) * 1024 + z)


def checked_queries(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """The queries as (n, 3) float64.

    Raises:
        InvalidQuery: wrong shape, or a coordinate that is not finite.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidQuery(f"queries must be an (n, 3) array, not of shape {points.shape}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InvalidQuery(f"row {row} has a coordinate that is not finite; remove or repair it")
    return points.astype(np.float64)
