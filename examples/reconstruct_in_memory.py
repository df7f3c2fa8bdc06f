"""The library without files: a cloud from NumPy, a mesh, and distances.

python examples/reconstruct_in_memory.py torus.glb
"""

import sys
from pathlib import Path

import numpy as np

from udflow.cloud.point_cloud import PointCloud
from udflow.config import from_dict
from udflow.mesh.export import write_mesh
from udflow.reconstruct import reconstruct

RING, TUBE = 3.0, 1.0  # any units: what goes in comes back


def scan_of_a_torus(count: int, noise: float) -> PointCloud:
    """Points without normals and without inside or outside, as a scanner gives them."""
    random = np.random.default_rng(0)
    u, v = random.uniform(0, 2 * np.pi, (2, count))
    around = RING + TUBE * np.cos(v)
    points = np.column_stack([around * np.cos(u), around * np.sin(u), TUBE * np.sin(v)])
    return PointCloud(points + random.normal(0, noise, points.shape))


def main(output: Path, resolution: int = 64) -> None:
    """Reconstruct, write the mesh, ask for distances."""
    cloud = scan_of_a_torus(3_000, noise=0.01)
    config = from_dict({"densify": {"target_points": 0}, "extract": {"resolution": resolution}})

    result = reconstruct(
        cloud, config, on_progress=lambda now: print(f"{now.fraction:4.0%} {now.stage}")
    )

    write_mesh(result.mesh, output)
    print(f"{output}: {len(result.mesh.vertices)} vertices, {len(result.mesh.faces)} faces")

    answer = result.field.query(np.array([[RING, 0.0, TUBE - 0.4], [RING, 0.0, TUBE + 0.5]]))
    print(f"0.4 below the top, inside: {answer.distance[0]:.3f}, nearest {answer.closest[0]}")
    print(f"0.5 above the top:         {answer.distance[1]:.3f}, nearest {answer.closest[1]}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
