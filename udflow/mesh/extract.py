"""From a field to a triangle mesh: the order of the steps."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from udflow.config import ExtractConfig
from udflow.errors import EmptySurface
from udflow.fields.interface import ProjectiveField
from udflow.mesh.band import find_band, project_in_chunks
from udflow.mesh.crossings import find_crossings
from udflow.mesh.dual import dual_surface, triangles
from udflow.mesh.lattice import Lattice
from udflow.mesh.mesh import Mesh
from udflow.mesh.orientation import oriented
from udflow.mesh.topology import compacted

BAND_WIDTH = 1.3  # voxels: crossed edges end within 1, the rest allows for errors of the field


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
    surface = dual_surface(band, find_crossings(band))
    if surface.quads.shape[0] == 0:
        raise EmptySurface(
            f"The field has no surface near the {samples.shape[0]} points at resolution "
            f"{config.resolution}. Raise the resolution, or fit the field again with more points."
        )
    vertices = project_in_chunks(field, surface.vertices)
    faces = triangles(vertices, surface.quads)
    return _finished(vertices, faces)


def _finished(vertices: Tensor, faces: Tensor) -> Mesh:
    points, corners = compacted(vertices.double().cpu().numpy(), faces.cpu().numpy())
    return Mesh(points, oriented(points, corners))


def _spacing(samples: Tensor) -> Tensor:
    """(m,) distance of neighbouring samples around each, from the circle that holds eight."""
    points = samples.cpu().numpy()
    radius = cKDTree(points).query(points, k=9, workers=2)[0][:, -1]
    return torch.from_numpy(np.asarray(radius * (np.pi / 8) ** 0.5)).to(samples)
