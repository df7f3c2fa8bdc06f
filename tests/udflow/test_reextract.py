"""Other meshes from a field that is fitted already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shapes import Sphere

from udflow.cloud.point_cloud import PointCloud
from udflow.config import Config, DensifyConfig, ExtractConfig
from udflow.errors import EmptySurface
from udflow.progress import Progress
from udflow.reconstruct import Reconstruction, reconstruct, reconstruct_steps
from udflow.reextract import reextract

PLAIN = Config(extract=ExtractConfig(resolution=32), densify=DensifyConfig(target_points=0))
PLACE = np.array([512_345.5, 5_403_210.25, 312.0])
SIZE = 10.0


@pytest.fixture(scope="module")
def ball() -> Reconstruction:
    points = Sphere().sample(2000).double().numpy() * SIZE + PLACE
    colors = np.full((len(points), 3), (200, 30, 30), np.uint8)
    return reconstruct(PointCloud(points, colors=colors), PLAIN)


def test_added_points_are_no_data_here_either() -> None:
    cloud = PointCloud(Sphere().sample(800).double().numpy())
    densified = replace(PLAIN, densify=DensifyConfig(target_points=1600))
    first = reconstruct(cloud, densified)
    assert len(first.points.points) > 1500
    again = reextract(first.field, first.points, densified.extract, measured=800)
    assert len(again.vertices) == len(first.mesh.vertices)
    np.testing.assert_allclose(again.vertices, first.mesh.vertices, atol=1e-5)


def radii(vertices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vertices - PLACE, axis=1) / SIZE


@pytest.mark.parametrize("resolution", [24, 64])
def test_another_resolution(ball: Reconstruction, resolution: int) -> None:
    mesh = reextract(ball.field, ball.points, ExtractConfig(resolution=resolution))
    np.testing.assert_allclose(radii(mesh.vertices), 0.5, atol=4e-3)
    edges = np.linalg.norm(
        mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1
    )
    assert np.median(edges) == pytest.approx(SIZE / resolution, rel=0.4)
    assert mesh.colors is not None
    assert (mesh.colors == (200, 30, 30)).all()


def test_a_box_is_cut_out(ball: Reconstruction) -> None:
    low = PLACE - np.array([0.0, SIZE, SIZE])
    high = PLACE + np.array([SIZE, SIZE, 0.0])
    mesh = reextract(
        ball.field, ball.points, ExtractConfig(resolution=48), (tuple(low), tuple(high))
    )
    assert (mesh.vertices >= low - 1e-6).all()
    assert (mesh.vertices <= high + 1e-6).all()
    np.testing.assert_allclose(radii(mesh.vertices), 0.5, atol=5e-3)
    corners = mesh.vertices[mesh.faces]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(sides, axis=1).sum() / 2
    assert area == pytest.approx(np.pi * SIZE**2 / 4, rel=0.02)  # a quarter of the sphere


def test_an_empty_box_is_refused_in_words(ball: Reconstruction) -> None:
    far = PLACE + 50.0
    with pytest.raises(EmptySurface, match="choose another box"):
        reextract(ball.field, ball.points, PLAIN.extract, (tuple(far), tuple(far + 1.0)))
    inside = PLACE - 0.5, PLACE + 0.5
    with pytest.raises(EmptySurface, match="choose another box"):
        reextract(ball.field, ball.points, PLAIN.extract, (tuple(inside[0]), tuple(inside[1])))


def run(enough_after: int, config: Config) -> tuple[Reconstruction, list[Progress]]:
    told: list[Progress] = []
    cloud = PointCloud(Sphere().sample(800).double().numpy())
    steps = reconstruct_steps(cloud, config, enough=lambda: len(told) >= enough_after)

    while True:
        try:
            told.append(next(steps))
        except StopIteration as done:
            return done.value, told


def test_a_run_that_is_cut_short_gives_a_whole_mesh() -> None:
    config = replace(PLAIN, densify=DensifyConfig(target_points=4000, points_per_round=400))
    whole, every = run(10_000, config)
    first_fit = config.flow.steps + 2
    for enough_after in (1, first_fit + 2):
        result, told = run(enough_after, config)
        assert len(told) < len(every) - 3
        np.testing.assert_allclose(np.linalg.norm(result.mesh.vertices, axis=1), 0.5, atol=0.01)
        assert result.report["partial"] is True
        assert result.report["points"]["densified"] < whole.report["points"]["densified"]
    assert whole.report["partial"] is False
