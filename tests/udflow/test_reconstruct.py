"""The whole story: cloud in; mesh, field, points and report out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapes import Cube, Hemisphere, MoebiusStrip, Shape, Sphere, Torus

import udflow
from udflow.cloud.point_cloud import PointCloud
from udflow.config import Config, DensifyConfig, ExtractConfig, FlowConfig, SplineConfig, to_dict
from udflow.errors import EmptySurface, InvalidCloud
from udflow.fields.storage import field_to_bytes
from udflow.metrics.topology import boundary, topology
from udflow.progress import STAGES, Progress
from udflow.reconstruct import Reconstruction, reconstruct, reconstruct_steps

PLAIN = Config(extract=ExtractConfig(resolution=32), densify=DensifyConfig(target_points=0))
DENSER = replace(PLAIN, densify=DensifyConfig(target_points=1400, points_per_round=400))
UTM = np.array([512345.5, 5403210.25, 312.0])


def cloud_of(shape: Shape, count: int = 1500) -> PointCloud:
    return PointCloud(shape.sample(count).double().numpy())


def boundary_edges(result: Reconstruction) -> int:
    edges = np.sort(result.mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum())


def distances(shape: Shape, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return shape.distance(torch.from_numpy(points)).numpy()


# mean and largest distance of vertices from the surface: what is reached, and half as much again
SHAPES = [
    pytest.param(Sphere(), 6e-4, 4e-3, id="sphere"),
    pytest.param(Torus(), 7e-4, 8e-3, id="torus"),
    pytest.param(Hemisphere(), 2e-3, 6e-2, id="hemisphere"),
    pytest.param(MoebiusStrip(), 4e-3, 6e-2, id="moebius"),
]


@pytest.mark.parametrize(("shape", "mean", "largest"), SHAPES)
def test_the_mesh_lies_on_the_surface_and_covers_it(
    shape: Shape, mean: float, largest: float
) -> None:
    result = reconstruct(cloud_of(shape), PLAIN)
    error = distances(shape, result.mesh.vertices)
    assert error.mean() < mean
    assert error.max() < largest
    to_vertices, _ = cKDTree(result.mesh.vertices).query(shape.sample(2000, seed=9).numpy())
    assert to_vertices.max() < 1 / 32
    assert (boundary_edges(result) == 0) == (shape.loops == 0)


@pytest.fixture(scope="module")
def plain() -> Reconstruction:
    """A sphere from 500 points, as they are."""
    return reconstruct(cloud_of(Sphere(), 500), PLAIN)


@pytest.fixture(scope="module")
def steps() -> list[Progress]:
    """The progress of the fixture `sphere`."""
    return []


@pytest.fixture(scope="module")
def sphere(steps: list[Progress]) -> Reconstruction:
    """A coloured sphere of radius 20 m somewhere in UTM zone 32, densified in two rounds."""
    points = Sphere().sample(700).double().numpy()
    colors = np.where(points[:, 2:] > 0, [[200, 30, 10]], [[10, 40, 220]]).astype(np.uint8)
    cloud = PointCloud(40 * points + UTM, colors=colors, warnings=("this one shines",))
    return reconstruct(cloud, DENSER, on_progress=steps.append)


def test_everything_is_in_the_frame_of_the_scan(sphere: Reconstruction) -> None:
    for points in (sphere.mesh.vertices, sphere.points.points):
        assert points.dtype == np.float64
        radius = np.linalg.norm(points - UTM, axis=1)
        np.testing.assert_allclose(radius, 20, atol=0.25)
        assert np.abs(radius - 20).mean() < 0.04
    answer = sphere.field.query(UTM + np.array([[0, 0, 50.0], [0, 5.0, 0]]))
    np.testing.assert_allclose(answer.distance, [30, 15], atol=0.1)
    assert sphere.mesh.faces.dtype == np.int64


def test_the_answer_does_not_depend_on_the_units(plain: Reconstruction) -> None:
    """A power of two rounds nothing, so not a bit may change."""
    large = reconstruct(PointCloud(1024 * Sphere().sample(500).double().numpy()), PLAIN)
    np.testing.assert_array_equal(1024 * plain.mesh.vertices, large.mesh.vertices)
    np.testing.assert_array_equal(plain.mesh.faces, large.mesh.faces)


def test_colours_are_carried_over(sphere: Reconstruction) -> None:
    for points, colors in (
        (sphere.mesh.vertices, sphere.mesh.colors),
        (sphere.points.points, sphere.points.colors),
    ):
        assert colors is not None
        height = points[:, 2] - UTM[2]
        assert (colors[height > 4] == [200, 30, 10]).all()
        assert (colors[height < -4] == [10, 40, 220]).all()


def test_without_colours_there_are_none(plain: Reconstruction) -> None:
    assert plain.mesh.colors is None
    assert plain.points.colors is None


def test_the_points_are_the_measured_ones_and_more(sphere: Reconstruction) -> None:
    measured = 40 * Sphere().sample(700).double().numpy() + UTM
    assert len(sphere.points.points) == 1400
    first = sphere.points.points[:700]
    order, expected = np.lexsort(first.round(4).T), np.lexsort(measured.round(4).T)
    np.testing.assert_allclose(first[order], measured[expected], rtol=0, atol=1e-5)


def astray(share: float, count: int = 3000) -> PointCloud:
    """A sphere, and points anywhere around it."""
    points = Sphere().sample(count).double().numpy()
    others = np.random.default_rng(4).uniform(-0.6, 0.6, (round(share * count), 3))
    return PointCloud(np.concatenate([points, others]))


def test_points_on_no_surface_are_left_out_and_said() -> None:
    result = reconstruct(astray(0.05), PLAIN)
    assert np.abs(np.linalg.norm(result.mesh.vertices, axis=1) - 0.5).max() < 0.04
    assert boundary_edges(result) == 0
    points = result.report["points"]
    assert 3000 <= points["measured"] < 3100
    assert len(result.points.points) == points["measured"]
    count = points["unique"] - points["measured"]
    assert result.report["warnings"] == [
        f"left out {count} points that are scattered in space, on no surface"
    ]


def test_a_stray_point_far_away_costs_no_detail() -> None:
    points = Sphere().sample(2000).double().numpy()
    far = reconstruct(PointCloud(np.concatenate([points, [[60.0, -80.0, 5.0]]])), PLAIN)
    alone = reconstruct(PointCloud(points), PLAIN)
    np.testing.assert_array_equal(far.mesh.vertices, alone.mesh.vertices)
    assert far.report["frame"] == alone.report["frame"]


def test_all_points_are_taken_where_that_is_asked_for() -> None:
    result = reconstruct(astray(0.05), replace(PLAIN, outliers="keep"))
    assert result.report["points"]["measured"] == 3150
    assert result.report["warnings"] == []


def test_edges_between_few_samples_do_not_gape() -> None:
    """Now and then one does, by chance: of 20 such cubes 2."""
    config = replace(PLAIN, extract=ExtractConfig(resolution=64))
    cubes = [PointCloud(Cube().sample(800, seed=seed).double().numpy()) for seed in range(1, 5)]
    assert sum(boundary_edges(reconstruct(cube, config)) > 0 for cube in cubes) <= 1


def test_a_plate_less_than_two_spacings_thick_is_closed() -> None:
    size, count = np.array([1.0, 0.7, 0.04]), 3000
    spacing = np.sqrt(1.4 / count)  # of samples, 0.022
    generator = np.random.default_rng(0)
    area = np.prod(size) / size
    axis = generator.choice(3, count, p=area / area.sum())
    points = generator.random((count, 3)) - 0.5
    points[np.arange(count), axis] = generator.choice([-0.5, 0.5], count)
    config = replace(PLAIN, extract=ExtractConfig(resolution=96))
    result = reconstruct(PointCloud(points * size), config)
    assert boundary_edges(result) == 0
    inner = (np.abs(result.mesh.vertices) < 0.5 * size - spacing)[:, :2].all(axis=1)
    height = np.abs(result.mesh.vertices[inner, 2])
    assert np.abs(height - 0.5 * size[2]).mean() < 0.03 * spacing


def test_a_window_is_as_wide_as_its_samples_say() -> None:
    count, radius = 4000, 0.06  # 3.9 spacings
    points = np.random.default_rng(1).random((count, 3)) - 0.5
    points[:, 2] = 0.1 * np.sin(3 * points[:, 0])
    centres = np.array([[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]])
    apart = np.linalg.norm(points[:, None, :2] - centres, axis=2)
    points = points[(apart > radius).all(axis=1)]
    config = replace(PLAIN, extract=ExtractConfig(resolution=96))
    mesh = reconstruct(PointCloud(points), config).mesh
    found = topology(mesh)
    assert (found.boundary_loops, found.components, found.euler_number) == (5, 1, -3)
    rim = mesh.vertices[np.unique(boundary(mesh)), :2]
    away = np.linalg.norm(rim[:, None] - centres, axis=2).min(axis=1)
    assert abs(away[away < 0.15].mean() - radius) < 0.005
    outer = np.abs(rim[away > 0.15]).max(axis=1)
    assert abs(outer.mean() - 0.5) < 0.005


def test_added_points_are_no_data_for_the_mesh() -> None:
    # where they are dense on one side of an edge only, a mesh that takes them for data ends there
    config = Config(extract=ExtractConfig(resolution=64), densify=DensifyConfig(target_points=6000))
    result = reconstruct(PointCloud(Cube().sample(800, seed=1).double().numpy()), config)
    assert len(result.points.points) == 6000
    assert boundary_edges(result) == 0


def test_progress_never_falls_and_ends_at_one(
    sphere: Reconstruction, steps: list[Progress]
) -> None:
    fractions = [p.fraction for p in steps]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    assert len(set(fractions)) > 8
    assert all(0 <= p.step <= p.total for p in steps)
    assert [p.elapsed_s for p in steps] == sorted(p.elapsed_s for p in steps)
    order = [STAGES.index(p.stage) for p in steps]
    assert order == sorted(order)
    assert set(order) == set(range(5))


def test_progress_tells_rounds_points_and_loss(
    sphere: Reconstruction, steps: list[Progress]
) -> None:
    assert {p.rounds for p in steps} == {2}
    assert list(dict.fromkeys((p.round, p.points) for p in steps)) == [
        (0, 700),
        (1, 1100),
        (2, 1400),
    ]
    losses = [p.loss for p in steps if p.stage in ("densifying", "extracting")]
    assert all(loss is not None and 0 < loss < 1e-2 for loss in losses)
    assert steps[0].loss is None


def test_the_report_is_json_and_says_what_was_done(sphere: Reconstruction) -> None:
    report = json.loads(json.dumps(sphere.report, allow_nan=False))
    assert report["config"] == to_dict(DENSER)
    assert report["version"] == udflow.__version__
    assert report["device"] == "cpu"
    assert report["points"] == {
        "input": 700,
        "unique": 700,
        "measured": 700,
        "densified": 1400,
        "rounds": 2,
    }
    assert report["frame"]["scale"] == pytest.approx(40, rel=0.01)
    assert report["frame"]["centre"] == pytest.approx(UTM.tolist(), abs=0.2)
    spacing = 40 * (np.pi / 700) ** 0.5
    assert report["spacing"] == pytest.approx(spacing, rel=0.15)
    assert 0 < report["sample_error"] < 0.1 * spacing
    assert report["mesh"]["vertices"] == len(sphere.mesh.vertices)
    assert report["mesh"]["faces"] == len(sphere.mesh.faces)
    assert report["warnings"] == ["this one shines"]
    assert 0 < report["loss"] < 1e-2


def test_the_seconds_add_up(sphere: Reconstruction) -> None:
    seconds = dict(sphere.report["seconds"])
    total = seconds.pop("total")
    assert set(seconds) == {"fitting", "densifying", "extracting", "exporting"}
    assert sum(seconds.values()) == pytest.approx(total, rel=0.05)


def as_bytes(result: Reconstruction) -> list[bytes]:
    arrays = [result.mesh.vertices, result.mesh.faces, result.points.points]
    return [*(a.tobytes() for a in arrays), field_to_bytes(result.field)]


def test_the_same_seed_gives_the_same_bytes_and_another_does_not() -> None:
    config = Config(
        flow=FlowConfig(steps=3),
        extract=ExtractConfig(resolution=20),
        densify=DensifyConfig(target_points=500, points_per_round=200),
    )
    cloud = cloud_of(Torus(), 400)
    one, two = reconstruct(cloud, config), reconstruct(cloud, config)
    assert as_bytes(one) == as_bytes(two)
    other = reconstruct(cloud, replace(config, seed=1))
    assert one.points.points.tobytes() != other.points.points.tobytes()


def test_a_point_measured_twice_counts_once(plain: Reconstruction) -> None:
    once = cloud_of(Sphere(), 500)
    twice = PointCloud(np.concatenate([once.points, once.points[::-1]]))
    two = reconstruct(twice, PLAIN)
    assert plain.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()
    assert two.report["points"]["input"] == 1000
    assert two.report["points"]["unique"] == 500


def test_what_the_configuration_says_is_done(plain: Reconstruction) -> None:
    """Twice the resolution has four times as many vertices on a surface."""
    config = Config(
        spline=SplineConfig(resolution=20),
        extract=ExtractConfig(resolution=64),
        densify=DensifyConfig(target_points=0),
    )
    result = reconstruct(cloud_of(Sphere(), 500), config)
    assert result.field.fitted.levels[0].grid.spacing == pytest.approx(1 / 20)
    assert result.report["spline_resolution"] == 20
    assert 3.8 < len(result.mesh.vertices) / len(plain.mesh.vertices) < 4.2


def test_it_can_be_left_between_two_steps() -> None:
    steps = reconstruct_steps(cloud_of(Sphere(), 500), PLAIN)
    assert next(steps).stage == "reading"
    assert next(steps).stage == "fitting"
    steps.close()


def test_a_caller_s_stop_goes_through() -> None:
    def stop(progress: Progress) -> None:
        if progress.stage == "fitting":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(cloud_of(Sphere(), 500), PLAIN, on_progress=stop)


def test_it_leaves_the_caller_s_gradients_alone(plain: Reconstruction) -> None:
    assert torch.is_grad_enabled()
    assert not torch.is_inference_mode_enabled()


def test_too_few_points_are_refused_before_anything_is_done() -> None:
    said: list[Progress] = []
    with pytest.raises(InvalidCloud, match="99 distinct points; a surface needs at least 100"):
        reconstruct(cloud_of(Sphere(), 99), PLAIN, on_progress=said.append)
    assert not said


def test_a_line_has_no_surface() -> None:
    line = np.linspace(0, 1, 300)[:, None] * np.array([[1.0, 2.0, -3.0]]) + 4e5
    with pytest.raises(InvalidCloud, match="all points lie on one straight line"):
        reconstruct(PointCloud(line), PLAIN)


def test_a_circle_has_none_either() -> None:
    angle = np.linspace(0, 2 * np.pi, 300)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(300)], axis=1)
    coarse = replace(PLAIN, extract=replace(PLAIN.extract, resolution=16))
    with pytest.raises(EmptySurface, match="no surface near the 300 points at resolution 16"):
        reconstruct(PointCloud(circle), coarse)


def test_specks_far_smaller_than_their_distance_keep_distances_right() -> None:
    """Two specks ten thousand times their size apart, smaller than a voxel."""
    speck = 1e-4 * np.random.default_rng(0).normal(size=(300, 3))
    keep = replace(PLAIN, outliers="keep")  # balls of points, no surfaces
    result = reconstruct(PointCloud(np.concatenate([speck, speck + 1.0])), keep)
    found = result.field.query(np.array([[0.5, 0.5, 0.5], [0, 0, 0.1]])).distance
    np.testing.assert_allclose(found, [np.sqrt(0.75), 0.1], atol=5e-4)
