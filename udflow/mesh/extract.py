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
from udflow.mesh.cleaning import without_dust
from udflow.mesh.crossings import find_crossings
from udflow.mesh.draft import Draft
from udflow.mesh.dual import DualSurface, dual_surface, triangles
from udflow.mesh.holes import closed
from udflow.mesh.lattice import Lattice
from udflow.mesh.manifold import separated
from udflow.mesh.marching import FAR, FAR_SPACINGS, marched
from udflow.mesh.mesh import Mesh
from udflow.mesh.orientation import oriented
from udflow.mesh.rims import faired
from udflow.mesh.support import SampleSet
from udflow.mesh.topology import edges_of
from udflow.mesh.trim import trimmed

FAIRING = 2.0  # spacings: rims waver by less than this
BAND_WIDTH = 1.1  # voxels: both ends of a crossed edge lie within 1
LONGEST_WAY = 0.75  # voxels from the mean crossing to its foot: farther, it was no crossing


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
    by = _by_cells if config.extractor == "cap" else _by_edges
    mesh = by(field, samples, lattice)
    if len(mesh.faces) == 0:
        raise EmptySurface(
            f"The field has no surface near the {samples.shape[0]} points at resolution "
            f"{config.resolution}. Raise the resolution, or fit the field again with more points."
        )
    return mesh


def _by_edges(field: ProjectiveField, samples: Tensor, lattice: Lattice) -> Mesh:
    """Edge flags, dual vertices, and what makes the result clean."""
    band = find_band(field, samples, _spacing(samples), lattice, BAND_WIDTH)
    surface = dual_surface(lattice, find_crossings(field, band))
    draft = _on_surface(field, surface, lattice.step)
    if len(draft.faces) > 0:
        draft = _finished(field, draft, samples, lattice.step)
    return Mesh(draft.vertices, draft.faces)


def _by_cells(field: ProjectiveField, samples: Tensor, lattice: Lattice) -> Mesh:
    """The paper's protocol: marching cell by cell, then dropping what is far from the samples.
    Orientation apart, nothing is repaired."""
    spacing = _spacing(samples)
    points, triangles = marched(field, samples, spacing, lattice)
    vertices, faces = points.double().cpu().numpy(), triangles.cpu().numpy()
    tree = cKDTree(samples.double().cpu().numpy())
    distance = tree.query(vertices, workers=2)[0]
    limit = max(FAR, FAR_SPACINGS * float(spacing.median()))
    faces = faces[distance[faces].mean(axis=1) <= limit]
    faces = oriented(vertices, faces, edges_of(faces))
    draft = Draft(vertices, faces, np.zeros(len(vertices), dtype=bool)).compacted()
    return Mesh(draft.vertices, draft.faces)


def _on_surface(field: ProjectiveField, surface: DualSurface, voxel: float) -> Draft:
    """Oriented triangles whose vertices are moved onto the surface, without false sheets: parts
    whose vertices were nowhere near it."""
    feet = project_in_chunks(field, surface.vertices)
    astray = torch.linalg.vector_norm(feet - surface.vertices, dim=1) > LONGEST_WAY * voxel
    kept = surface.quads[~astray[surface.quads].any(dim=1)].cpu().numpy()
    vertices = feet.double().cpu().numpy()
    edges = edges_of(kept)
    loose = np.zeros(len(vertices), dtype=bool)
    loose[edges.ends[edges.count != 2]] = True
    quads = torch.from_numpy(oriented(vertices, kept, edges)).to(feet.device)
    return Draft(vertices, triangles(feet, quads).cpu().numpy(), loose).compacted()


def _finished(field: ProjectiveField, draft: Draft, samples: Tensor, voxel: float) -> Draft:
    """Only what the samples support, and that whole."""

    def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
        feet = project_in_chunks(field, torch.from_numpy(points).to(samples))
        return np.asarray(feet.double().cpu().numpy())

    data = SampleSet.of(samples.double().cpu().numpy(), voxel)
    draft = trimmed(draft, data, voxel, project)
    draft = without_dust(draft, data, voxel)
    draft = closed(separated(draft), data, project)
    return faired(draft, FAIRING * data.spacing, voxel, project)


def _spacing(samples: Tensor) -> Tensor:
    """(m,) distance of neighbouring samples around each, from the circle that holds eight."""
    points = samples.cpu().numpy()
    count = min(9, len(points))
    radius = cKDTree(points).query(points, k=[count], workers=2)[0][:, 0]
    return torch.from_numpy(radius * (np.pi / count) ** 0.5).to(samples)
