"""Another mesh from a field that is fitted already: finer, coarser, or a part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.cloud.point_cloud import PointCloud
from udflow.config import ExtractConfig
from udflow.errors import EmptySurface
from udflow.fields.unsigned import UnsignedDistanceField
from udflow.mesh.colour import transfer_colors
from udflow.mesh.extract import extract
from udflow.mesh.mesh import Mesh

_MARGIN = 6.0  # spacings around a box: rims of the cropped data lie outside of it
_FEWEST = 16  # points, below which there is no surface to speak of

Corner = tuple[float, float, float]


def reextract(
    field: UnsignedDistanceField,
    points: PointCloud,
    config: ExtractConfig,
    box: tuple[Corner, Corner] | None = None,
    device: str = "cpu",
    measured: int | None = None,
) -> Mesh:
    """The surface of a stored field as triangles, in world units and frame.

    Args:
        field: as `load_field` gives it, on `device`.
        points: the densified cloud of the same reconstruction; gives the colours.
        config: resolution, in cells along the largest extent of what is extracted, and extractor.
        box: two opposite corners in world coordinates; the mesh is cut at its sides.
        device: where the field is.
        measured: how many of the points, the first ones, were measured and not added: they say
            where there is data (`points.measured` of the report). All if None.

    Raises:
        EmptySurface: there is no surface, or none inside the box.
    """
    data = points.points[:measured]
    kept = data if box is None else _around(data, box)
    samples = torch.from_numpy(field.normalisation.to_unit(kept)).to(device)
    with torch.inference_mode():
        mesh = extract(field.unit, samples, config)
    mesh = replace(mesh, vertices=field.normalisation.to_world(mesh.vertices))
    if box is not None:
        mesh = _cut(mesh, box)
    return replace(mesh, colors=transfer_colors(mesh.vertices, points))


def _around(points: NDArray[np.float64], box: tuple[Corner, Corner]) -> NDArray[np.float64]:
    distances = cKDTree(points).query(points[:: max(1, len(points) // 1000)], k=[2], workers=2)[0]
    margin = _MARGIN * float(np.median(distances))
    low, high = np.asarray(box[0]) - margin, np.asarray(box[1]) + margin
    inside = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(inside) < _FEWEST:
        raise EmptySurface("there are no points of the scan inside the box; choose another box")
    return inside


def _cut(mesh: Mesh, box: tuple[Corner, Corner]) -> Mesh:
    """What of the mesh lies inside the box, cut along its sides."""
    # Takes half a second to import, which workers need not pay for every other job.
    import trimesh

    vertices, faces = mesh.vertices, mesh.faces
    for corner, sign in ((box[0], 1.0), (box[1], -1.0)):
        for axis in range(3):
            normal = np.zeros(3)
            normal[axis] = sign
            vertices, faces = trimesh.intersections.slice_faces_plane(
                vertices, faces, normal, np.asarray(corner)
            )[:2]
            if len(faces) == 0:
                raise EmptySurface("there is no surface inside the box; choose another box")
    return Mesh(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
