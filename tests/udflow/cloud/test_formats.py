"""Every format gives back what was written, whatever the file is called."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cloud_files as files
import numpy as np
import pytest

from udflow.cloud.formats import read_cloud
from udflow.cloud.point_cloud import PointCloud

Read = Callable[[bytes], PointCloud]
SAMPLES = files.samples()
NO_COLORS = {"text-csv", "npy", "npz-compressed", "stl", "stl-ascii"}
WITH_NORMALS = {"ply-little", "ply-big", "text-csv", "glb"}


def _sorted(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.T)]


@pytest.mark.parametrize("name", SAMPLES)
def test_points_come_back(name: str, read: Read) -> None:
    cloud = read(SAMPLES[name])
    assert cloud.format == name.split("-")[0].replace("laz", "las")
    assert cloud.points.dtype == np.float64
    assert cloud.points.shape == (400, 3)
    expected = files.POINTS.astype(np.float64)
    if cloud.format == "las":  # millimetres, far from the origin
        np.testing.assert_allclose(cloud.points, expected + files.UTM, rtol=0, atol=0.0006)
    else:  # our OBJ has 16 digits
        atol = 1e-15 if name == "obj" else 0.0
        np.testing.assert_allclose(_sorted(cloud.points), _sorted(expected), rtol=0, atol=atol)
    assert (cloud.dropped, cloud.warnings) == (0, ())


@pytest.mark.parametrize("name", SAMPLES)
def test_colors_and_normals_come_back(name: str, read: Read) -> None:
    cloud = read(SAMPLES[name])
    assert (cloud.colors is not None) == (name not in NO_COLORS)
    if cloud.colors is not None:
        assert cloud.colors.dtype == np.uint8
        np.testing.assert_array_equal(cloud.colors, files.COLORS)
    assert (cloud.normals is not None) == (name in WITH_NORMALS)
    if cloud.normals is not None and name != "glb":  # a mesh's normals are its own
        assert cloud.normals.dtype == np.float32
        np.testing.assert_array_equal(cloud.normals, files.NORMALS)


@pytest.mark.parametrize("suffix", [".ply", ".csv", ".png", ""])
def test_the_content_decides_not_the_name(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"{'ü' * 50}{suffix}"
    path.write_bytes(SAMPLES["pcd-binary"])
    assert read_cloud(path).format == "pcd"


@pytest.mark.parametrize("name", ["ply-big", "npy", "text-csv", "obj", "off"])
def test_map_coordinates_keep_their_millimetres(name: str, read: Read) -> None:
    world = files.POINTS.astype(np.float64) + files.UTM
    content = {
        "ply-big": files.ply(">", world),
        "npy": files.npy(world),
        "text-csv": files.table(world, ";"),
        "obj": b"".join(b"v " + line + b"\n" for line in files.table(world).splitlines()),
        "off": b"OFF 400 0 0\n" + files.table(world),
    }[name]
    np.testing.assert_array_equal(read(content).points, world)


@pytest.mark.parametrize("name", ["ply-little", "text-csv", "npy", "pcd-binary", "pcd-compressed"])
def test_points_that_are_not_finite_are_dropped_and_counted(name: str, read: Read) -> None:
    points = files.POINTS.copy()
    points[5, 1], points[17, 0], points[399, 2] = np.nan, np.inf, -np.inf
    kept = np.delete(np.arange(400), [5, 17, 399])
    content = {
        "ply-little": files.ply("<", points),
        "text-csv": files.table(points),
        "npy": files.npy(points),
        "pcd-binary": files.pcd("binary", points),
        "pcd-compressed": files.pcd("binary_compressed", points),
    }[name]
    cloud = read(content)
    np.testing.assert_array_equal(cloud.points, points[kept])
    assert cloud.dropped == 3
    assert cloud.warnings == ("3 points with undefined or infinite coordinates were left out",)
    if cloud.colors is not None:
        np.testing.assert_array_equal(cloud.colors, files.COLORS[kept])
