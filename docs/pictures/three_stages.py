"""The picture at the top of the README: a scan, its densification by rounds, its mesh.

Run from the root of the repository: `python docs/pictures/three_stages.py [SAMPLE]`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.samples import sample
from udflow.config import Config, DensifyConfig
from udflow.mesh.mesh import Mesh
from udflow.picture import Image, View, mesh_picture, points_picture
from udflow.png import png
from udflow.progress import GrownCloud
from udflow.reconstruct import reconstruct_steps

TARGET = Path(__file__).with_suffix(".png")
SIZE = (560, 430)
PAPER = np.array([240, 238, 234], np.uint8)
INK = np.array([44, 67, 80], np.uint8)
# the colours of the page: the first round, ..., the last
AGES = np.array([[120, 6, 166], [184, 50, 137], [219, 92, 104], [246, 140, 70]])


def main(name: str) -> None:
    """Reconstructs a sample and draws three stages of it beside each other."""
    cloud = sample(name)
    config = replace(Config(), densify=DensifyConfig(target_points=30_000, points_per_round=3_000))
    grown, mesh = reconstructed(cloud, config)
    view = View.around(cloud.points, azimuth=-30.0, elevation=20.0)
    scan = np.broadcast_to(INK, cloud.points.shape) if cloud.colors is None else cloud.colors
    panels = (
        points_picture(cloud.points, scan, SIZE, view, radius=1.0),
        points_picture(grown.points, by_round(grown.rounds), SIZE, view, radius=0.8),
        mesh_picture(mesh, SIZE, view),
    )
    TARGET.write_bytes(png(np.hstack([on_paper(panel) for panel in panels])))


def reconstructed(cloud: PointCloud, config: Config) -> tuple[GrownCloud, Mesh]:
    """The densified cloud with the round of each point, and the mesh."""
    steps = reconstruct_steps(cloud, config)
    grown = GrownCloud(cloud.points, np.zeros(len(cloud.points), np.int64))
    while True:
        try:
            progress = next(steps)
        except StopIteration as end:
            return grown, end.value.mesh
        if progress.look is not None:
            grown = progress.look.cloud()


def by_round(rounds: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(n, 3) the colour of each point: ink for measured ones."""
    place = (rounds - 1) / max(rounds.max() - 1, 1) * (len(AGES) - 1)
    stops = np.arange(len(AGES))
    colors = np.stack([np.interp(place, stops, AGES[:, i]) for i in range(3)], axis=1)
    return np.where(rounds[:, None] > 0, colors, INK).astype(np.uint8)


def on_paper(image: Image) -> Image:
    """Without transparency, so that it is readable on dark pages too."""
    share = image[..., 3:] / 255.0
    color = image[..., :3] * share + PAPER * (1.0 - share)
    opaque = np.full((*image.shape[:2], 1), 255.0)
    return np.concatenate([color, opaque], axis=-1).astype(np.uint8)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "shirt")
