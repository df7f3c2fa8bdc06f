"""From a field to a triangle mesh: the order of the steps."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from udflow.config import ExtractConfig
from udflow.errors import EmptySurface
from udflow.fields.interface import ProjectiveField
from udflow.mesh.band import find_band, project_in_chunks
from udflow.mesh.cleaning import without_dust, without_false_sheets
from udflow.mesh.crossings import find_crossings
from udflow.mesh.dual import DualSurface, dual_surface, triangles
from udflow.mesh.holes import closed
from udflow.mesh.lattice import Lattice
from udflow.mesh.manifold import separated
from udflow.mesh.mesh import Mesh
from udflow.mesh.orientation import facing_outwards, oriented
from udflow.mesh.topology import compacted
from udflow.mesh.trim import trimmed

BAND_WIDTH = 1.1  # voxels: both ends of a crossed edge lie within 1


def extract(field: ProjectiveField, samples: Tensor, config: ExtractConfig) -> Mesh:
    """The surface of a field as triangles.

    Args:
        field: where the surface is.
        samples: (m, 3) float32 points near the surface, unit frame; they say where to look and
            where the data ends.
        config: resolution and extractor.

    Returns:
        The mesh in the unit frame.

    Raises:
        EmptySurface: no surface near the samples at this resolution.
    """
    lattice = Lattice.around(samples, config.resolution)
    spacing = _spacing(samples)
    band = find_band(field, samples, spacing, lattice, BAND_WIDTH)
    surface = dual_surface(lattice, find_crossings(field, band))
    mesh = _on_surface(field, surface, lattice.step)
    if len(mesh.faces) > 0:
        mesh = _finished(field, mesh, samples, float(spacing.median()), lattice.step)
    if len(mesh.faces) == 0:
        raise EmptySurface(
            f"The field has no surface near the {samples.shape[0]} points at resolution "
            f"{config.resolution}. Raise the resolution, or fit the field again with more points."
        )
    return mesh


def _on_surface(field: ProjectiveField, surface: DualSurface, voxel: float) -> Mesh:
    vertices = project_in_chunks(field, surface.vertices)
    moved = torch.linalg.vector_norm(vertices - surface.vertices, dim=1)
    faces = triangles(vertices, surface.quads)
    mesh = Mesh(vertices.double().cpu().numpy(), faces.cpu().numpy())
    return without_false_sheets(mesh, moved.double().cpu().numpy(), voxel)


def _finished(
    field: ProjectiveField, mesh: Mesh, samples: Tensor, spacing: float, voxel: float
) -> Mesh:
    """Without what the samples do not support, whole and oriented."""

    def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
        feet = project_in_chunks(field, torch.from_numpy(points).to(samples))
        return np.asarray(feet.double().cpu().numpy())

    data = samples.double().cpu().numpy()
    mesh = oriented(mesh)
    mesh = trimmed(mesh, data, voxel)
    mesh = without_dust(mesh, data, max(spacing, voxel))
    mesh = separated(mesh)
    mesh = closed(mesh, data, voxel, project)
    return facing_outwards(compacted(mesh))


def _spacing(samples: Tensor) -> Tensor:
    """(m,) distance of neighbouring samples around each, from the circle that holds eight."""
    points = samples.cpu().numpy()
    count = min(9, len(points))
    radius = cKDTree(points).query(points, k=[count], workers=2)[0][:, 0]
    return torch.from_numpy(radius * (np.pi / count) ** 0.5).to(samples)
