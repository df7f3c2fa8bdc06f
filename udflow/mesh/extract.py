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
from udflow.mesh.coincident import without_coincident
from udflow.mesh.crosscaps import without_crosscaps
from udflow.mesh.crossings import find_crossings
from udflow.mesh.draft import Draft
from udflow.mesh.dual import DualSurface, dual_surface, triangles
from udflow.mesh.folds import unfolded
from udflow.mesh.handles import without_small_handles
from udflow.mesh.holes import closed
from udflow.mesh.lattice import Lattice
from udflow.mesh.manifold import separated
from udflow.mesh.marching import FAR, FAR_SPACINGS, marched
from udflow.mesh.mesh import Mesh
from udflow.mesh.necks import without_necks
from udflow.mesh.orientation import oriented
from udflow.mesh.rims import faired
from udflow.mesh.settling import settled
from udflow.mesh.support import SampleSet
from udflow.mesh.topology import edges_of, parts
from udflow.mesh.trim import trimmed

FAIRING = 2.0  # spacings: rims waver by less than this
BAND_WIDTH = 1.1  # voxels: both ends of a crossed edge lie within 1
LONGEST_WAY = 0.75  # voxels from the mean crossing to its foot: farther, it is astray
LARGEST_MISS = 24  # vertices astray together that may be slips; more are a false sheet
EASING = 3  # steps to the mean of the neighbours


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
    mesh = Mesh(draft.vertices, draft.faces)
    mesh = settled(mesh, field, lattice.step, samples.device)
    return without_coincident(unfolded(mesh), lattice.step)


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
    """Oriented triangles whose vertices are moved onto the surface, without false sheets: patches
    of vertices that are nowhere near it."""
    feet = project_in_chunks(field, surface.vertices)
    astray = torch.linalg.vector_norm(feet - surface.vertices, dim=1) > LONGEST_WAY * voxel
    false = _in_large_patch(surface.quads, astray)
    feet = _eased(field, feet, surface.quads, astray & ~false)
    kept = surface.quads[~false[surface.quads].any(dim=1)].cpu().numpy()
    vertices = feet.double().cpu().numpy()
    edges = edges_of(kept)
    loose = np.zeros(len(vertices), dtype=bool)
    loose[edges.ends[edges.count != 2]] = True
    quads = torch.from_numpy(oriented(vertices, kept, edges)).to(feet.device)
    return Draft(vertices, triangles(feet, quads).cpu().numpy(), loose).compacted()


def _in_large_patch(quads: Tensor, chosen: Tensor) -> Tensor:
    """(v,) those of the chosen vertices that hang together in patches of many."""
    sides = _sides(quads)
    inside = sides[chosen[sides].all(dim=1)].cpu().numpy()
    label = parts(inside, len(chosen))
    size = np.bincount(label, chosen.cpu().numpy())
    return chosen & torch.from_numpy(size[label] > LARGEST_MISS).to(chosen.device)


def _eased(field: ProjectiveField, feet: Tensor, quads: Tensor, chosen: Tensor) -> Tensor:
    """(v, 3) feet with the chosen ones replaced by those of the mean of their neighbours.

    A few vertices astray in a sheet that is right are slips of the field at a crease; without them
    the sheet would have a hole.
    """
    if not bool(chosen.any()):
        return feet
    sides = _sides(quads)
    sides = torch.cat([sides, sides.flip(1)])
    sides = sides[chosen[sides[:, 0]]]
    place = torch.cumsum(chosen, dim=0)[sides[:, 0]] - 1
    moved = feet[chosen]
    degree = torch.bincount(place, minlength=len(moved)).clamp_min(1)[:, None]
    feet = feet.clone()
    for _ in range(EASING):
        moved = torch.zeros_like(moved).index_add_(0, place, feet[sides[:, 1]]) / degree
        feet[chosen] = moved
    feet[chosen] = project_in_chunks(field, moved)
    return feet


def _sides(quads: Tensor) -> Tensor:
    """(4q, 2) sides of quads, those inside a sheet twice."""
    return torch.stack([quads, quads.roll(-1, dims=1)], dim=2).reshape(-1, 2)


def _finished(field: ProjectiveField, draft: Draft, samples: Tensor, voxel: float) -> Draft:
    """Only what the samples support, and that whole."""

    def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
        feet = project_in_chunks(field, torch.from_numpy(points).to(samples))
        return np.asarray(feet.double().cpu().numpy())

    data = SampleSet.of(samples.double().cpu().numpy(), voxel)
    draft = trimmed(draft, data, voxel, project)
    draft = without_dust(draft, data, voxel)
    draft = without_crosscaps(separated(draft, data.spacing), data.spacing)
    draft = without_small_handles(draft)
    draft = closed(draft, data, project)
    draft = without_necks(draft, data, project)
    draft = without_dust(draft, data, voxel)
    return faired(draft, FAIRING * data.spacing, voxel, project)


def _spacing(samples: Tensor) -> Tensor:
    """(m,) distance of neighbouring samples around each, from the circle that holds eight."""
    points = samples.cpu().numpy()
    count = min(9, len(points))
    radius = cKDTree(points).query(points, k=[count], workers=2)[0][:, 0]
    return torch.from_numpy(radius * (np.pi / count) ** 0.5).to(samples)
