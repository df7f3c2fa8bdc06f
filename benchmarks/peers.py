"""Classical surface reconstruction by Open3D, one run a process: `peers.py METHOD CLOUD MESH`.

Open3D is no dependency of udflow: install it where the benchmarks run. Version 0.20 also needs
the system libraries libusb-1.0-0, libgl1 and libgomp1.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np

METHODS = ("poisson", "ball-pivoting")
NEIGHBOURS = 30
POISSON_DEPTH = 8


def missing(python: str) -> str | None:
    """Why peers cannot run with this Python, or None."""
    tried = subprocess.run(
        [python, "-c", "import open3d"], capture_output=True, text=True, check=False
    )
    if tried.returncode == 0:
        return None
    reason = (tried.stderr.strip().splitlines() or ["no reason given"])[-1]
    return (
        f"no peers in this table, since open3d cannot be imported ({reason}); install open3d for "
        "that Python, and libusb-1.0-0, libgl1 and libgomp1 into the system"
    )


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
