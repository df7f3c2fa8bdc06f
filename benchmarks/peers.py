"""Classical surface reconstruction by Open3D, one run a process: `peers.py METHOD CLOUD MESH`.

Open3D is no dependency of udflow: install it where the benchmarks run. Version 0.20 also needs
the system libraries libusb-1.0-0, libgl1 and libgomp1.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import numpy as np

METHODS = ("poisson", "ball-pivoting")
NEIGHBOURS = 30
POISSON_DEPTH = 8


def missing() -> str | None:
    """Why peers cannot run here, or None."""
    if importlib.util.find_spec("open3d") is None:
        return (
            "open3d is not installed, so there are no peers in this table; install open3d into "
            "this environment (and libusb-1.0-0, libgl1, libgomp1 into the system) for --peers"
        )
    try:
        import open3d  # noqa: F401
    except OSError as error:
        return (
            f"open3d is installed but does not load ({error}); it needs the system libraries "
            "libusb-1.0-0, libgl1 and libgomp1"
        )
    return None


def main(method: str, cloud_path: str, mesh_path: str) -> None:
    """Reconstruct with normals by PCA, made consistent over a graph: what a user would do."""
    import open3d

    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(np.load(cloud_path, allow_pickle=False))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    cloud.orient_normals_consistent_tangent_plane(NEIGHBOURS)
    mesh = _poisson(open3d, cloud) if method == "poisson" else _ball_pivoting(open3d, cloud)
    open3d.io.write_triangle_mesh(mesh_path, mesh)


def _poisson(open3d: Any, cloud: Any) -> Any:
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=POISSON_DEPTH
    )
    return mesh


def _ball_pivoting(open3d: Any, cloud: Any) -> Any:
    spacing = float(np.mean(cloud.compute_nearest_neighbor_distance()))
    radii = open3d.utility.DoubleVector([1.5 * spacing, 2.5 * spacing, 4.0 * spacing])
    return open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)


if __name__ == "__main__":
    main(*sys.argv[1:4])
