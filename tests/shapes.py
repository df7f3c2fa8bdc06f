"""Shapes whose samples, distances and topology are known exactly.

Every shape lies in the unit frame (centred, largest extent 1 unless its sizes are changed) and is
itself a `ProjectiveField`, so it can stand where a fitted field stands.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor


class Shape(ABC):
    """A surface with exact answers.

    Attributes:
        components: connected parts.
        loops: closed boundary curves.
        euler: vertices - edges + faces of any triangulation of the surface.
        orientable: False for one-sided surfaces.
    """

    components: ClassVar[int] = 1
    loops: ClassVar[int] = 0
    euler: ClassVar[int] = 2
    orientable: ClassVar[bool] = True

    def sample(self, count: int, seed: int = 0) -> Tensor:
        """(count, 3) float32 points on the surface, uniform by area."""
        return self._draw(count, torch.Generator().manual_seed(seed)).float()

    def closest(self, points: Tensor) -> Tensor:
        """(n, 3) nearest points of the surface, in the dtype of `points`."""
        return self._foot(points.double()).to(points.dtype)

    def distance(self, points: Tensor) -> Tensor:
        """(n,) exact unsigned distances, in the dtype of `points`."""
        exact = points.double()
        return torch.linalg.norm(exact - self._foot(exact), dim=1).to(points.dtype)

    def project(self, points: Tensor) -> Tensor:
        """The shape as a field: see `closest`."""
        return self.closest(points)

    @abstractmethod
    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        """(count, 3) float64 points, uniform by area."""

    @abstractmethod
    def _foot(self, points: Tensor) -> Tensor:
        """(n, 3) float64 nearest points of (n, 3) float64 points."""


def _uniform(count: int, columns: int, generator: torch.Generator) -> Tensor:
    return torch.rand((count, columns), generator=generator, dtype=torch.float64)


def _unit(vectors: Tensor, fallback: tuple[float, ...]) -> Tensor:
    """Unit vectors; a zero vector becomes `fallback`, one of its equally near directions."""
    length = torch.linalg.norm(vectors, dim=1, keepdim=True)
    spare = torch.tensor(fallback, dtype=vectors.dtype).expand_as(vectors)
    return torch.where(length > 0, vectors / length.clamp_min(1e-300), spare)


def _flat(plane: Tensor, height: Tensor | float = 0.0) -> Tensor:
    """(n, 2) positions and their z to (n, 3) points."""
    z = torch.as_tensor(height, dtype=plane.dtype).expand(plane.shape[0])
    return torch.cat([plane, z[:, None]], dim=1)


@dataclass(frozen=True)
class Sphere(Shape):
    """A sphere around the origin."""

    radius: float = 0.5

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        normal = torch.randn((count, 3), generator=generator, dtype=torch.float64)
        return self._foot(normal)

    def _foot(self, points: Tensor) -> Tensor:
        return self.radius * _unit(points, (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Hemisphere(Shape):
    """The half of a sphere with z >= 0, open below."""

    loops = 1
    euler = 1
    radius: float = 0.5

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        normal = torch.randn((count, 3), generator=generator, dtype=torch.float64)
        normal[:, 2] = normal[:, 2].abs()
        return self._foot(normal)

    def _foot(self, points: Tensor) -> Tensor:
        rim = _flat(_unit(points[:, :2], (1.0, 0.0)))
        dome = _unit(points, (0.0, 0.0, 1.0))
        return self.radius * torch.where(points[:, 2:] >= 0, dome, rim)


@dataclass(frozen=True)
class PlanePatch(Shape):
    """The square |x|, |y| <= half in the plane z = 0."""

    loops = 1
    euler = 1
    half: float = 0.5

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        return _flat(self.half * (2 * _uniform(count, 2, generator) - 1))

    def _foot(self, points: Tensor) -> Tensor:
        return _flat(points[:, :2].clamp(-self.half, self.half))


@dataclass(frozen=True)
class Annulus(Shape):
    """A disc in the plane z = 0 with a round hole in its middle."""

    loops = 2
    euler = 0
    outer: float = 0.5
    inner: float = 0.15

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        area, turn = _uniform(count, 2, generator).unbind(1)
        radius = torch.sqrt(self.inner**2 + area * (self.outer**2 - self.inner**2))
        angle = 2 * math.pi * turn
        return _flat(torch.stack([radius * angle.cos(), radius * angle.sin()], dim=1))

    def _foot(self, points: Tensor) -> Tensor:
        plane = points[:, :2]
        radius = torch.linalg.norm(plane, dim=1, keepdim=True).clamp(self.inner, self.outer)
        return _flat(radius * _unit(plane, (1.0, 0.0)))


@dataclass(frozen=True)
class TwoSheets(Shape):
    """Two parallel squares |x|, |y| <= half, `gap` apart."""

    components = 2
    loops = 2
    euler = 2
    gap: float = 0.02
    half: float = 0.5

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        plane = self.half * (2 * _uniform(count, 2, generator) - 1)
        side = torch.sign(_uniform(count, 1, generator)[:, 0] - 0.5)
        return _flat(plane, 0.5 * self.gap * side)

    def _foot(self, points: Tensor) -> Tensor:
        side = torch.where(points[:, 2] >= 0, 1.0, -1.0).double()
        return _flat(points[:, :2].clamp(-self.half, self.half), 0.5 * self.gap * side)


@dataclass(frozen=True)
class Cube(Shape):
    """The surface of the cube |x|, |y|, |z| <= half: sharp edges and corners."""

    half: float = 0.5

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        points = self.half * (2 * _uniform(count, 3, generator) - 1)
        side = torch.randint(0, 6, (count,), generator=generator)
        height = self.half * (2.0 * (side % 2) - 1).double()
        return points.scatter(1, (side // 2)[:, None], height[:, None])

    def _foot(self, points: Tensor) -> Tensor:
        inside = points.clamp(-self.half, self.half)
        axis = inside.abs().argmax(dim=1, keepdim=True)
        sign = torch.where(inside.gather(1, axis) >= 0, 1.0, -1.0).double()
        pushed = inside.scatter(1, axis, self.half * sign)
        outside = (points.abs() > self.half).any(dim=1, keepdim=True)
        return torch.where(outside, inside, pushed)


@dataclass(frozen=True)
class Torus(Shape):
    """A torus around the z axis."""

    euler = 0
    ring: float = 0.35
    tube: float = 0.15

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        # the area element grows with ring + tube cos(v): rejection keeps it exact
        spare = _uniform(8 * count + 64, 3, generator)
        u, v = (2 * math.pi * spare[:, :2]).unbind(1)
        keep = spare[:, 2] * (self.ring + self.tube) <= self.ring + self.tube * v.cos()
        u, v = u[keep][:count], v[keep][:count]
        around = self.ring + self.tube * v.cos()
        return torch.stack([around * u.cos(), around * u.sin(), self.tube * v.sin()], dim=1)

    def _foot(self, points: Tensor) -> Tensor:
        core = _flat(self.ring * _unit(points[:, :2], (1.0, 0.0)))
        return core + self.tube * _unit(points - core, (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class MoebiusStrip(Shape):
    """A strip of half width `half` that turns once by 180 degrees around the z axis.

    The ruling at angle u is a straight segment, so the nearest point is a search in u alone: it
    starts at the nearest of many samples and is refined to about 1e-8.
    """

    loops = 1
    euler = 0
    orientable = False
    ring: float = 0.4
    half: float = 0.12

    def _draw(self, count: int, generator: torch.Generator) -> Tensor:
        spare = _uniform(4 * count + 64, 3, generator)
        u, v = 2 * math.pi * spare[:, 0], self.half * (2 * spare[:, 1] - 1)
        area = torch.sqrt((self.ring + v * (u / 2).cos()) ** 2 + v**2 / 4)
        most = math.hypot(self.ring + self.half, self.half / 2)
        keep = spare[:, 2] * most <= area
        return self._at(u[keep][:count], v[keep][:count])

    def _at(self, u: Tensor, v: Tensor) -> Tensor:
        around = self.ring + v * (u / 2).cos()
        return torch.stack([around * u.cos(), around * u.sin(), v * (u / 2).sin()], dim=-1)

    def _on_ruling(self, points: Tensor, u: Tensor) -> Tensor:
        """(n, 3) nearest points of the segments at the angles u."""
        zero = torch.zeros_like(u)
        middle = self._at(u, zero)
        direction = self._at(u, zero + 1) - middle
        v = ((points - middle) * direction).sum(dim=1).clamp(-self.half, self.half)
        return self._at(u, v)

    @cached_property
    def _start(self) -> tuple[cKDTree, Tensor]:
        angles = torch.arange(512, dtype=torch.float64) * (2 * math.pi / 512)
        u, v = torch.meshgrid(
            angles, torch.linspace(-self.half, self.half, 33, dtype=torch.float64), indexing="ij"
        )
        return cKDTree(self._at(u, v).reshape(-1, 3).numpy()), u.reshape(-1)

    def _foot(self, points: Tensor) -> Tensor:
        tree, angles = self._start
        nearest = np.asarray(tree.query(points.numpy(), workers=2)[1])
        u = angles[torch.from_numpy(nearest)]
        low, high = u - 0.03, u + 0.03
        golden = (math.sqrt(5) - 1) / 2
        for _ in range(40):
            left, right = high - golden * (high - low), low + golden * (high - low)
            is_left = self._miss(points, left) < self._miss(points, right)
            low, high = torch.where(is_left, low, left), torch.where(is_left, right, high)
        return self._on_ruling(points, 0.5 * (low + high))

    def _miss(self, points: Tensor, u: Tensor) -> Tensor:
        return torch.linalg.norm(points - self._on_ruling(points, u), dim=1)


ALL_SHAPES: tuple[Shape, ...] = (
    Sphere(),
    Hemisphere(),
    PlanePatch(),
    Annulus(),
    TwoSheets(),
    Cube(),
    Torus(),
    MoebiusStrip(),
)
