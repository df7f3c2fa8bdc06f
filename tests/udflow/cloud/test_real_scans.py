"""Real scans and meshes, where they are at hand, hold as many points as their makers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from udflow.cloud.formats import read_cloud
from udflow.cloud.inspection import inspect, require_reconstructable

DATA = Path(__file__).resolve().parents[3] / "../shared/data"
# points, distinct points, dropped points, extent
SCANS = {
    "room_scan1.pcd": (112586, 56159, 0, (29.25, 14.47, 3.061)),
    "kinect_floor_chair.pcd": (259847, None, 47353, (2.882, 1.989, 2.978)),
    "kinect_person.pcd": (242749, None, 64451, (3.086, 2.768, 3.172)),
    "stereo_table_mug.pcd": (209280, None, 97920, (1.172, 0.69, 1.903)),
    "facade.pcd": (108104, None, 0, (5205, 7661, 1905)),
    "lidar_car_cloud400.csv": (24989, None, 0, (126.7, 130.7, 40.02)),
}
MESHES = {
    "closed/spot.obj": 2930,
    "closed/bunny_hr.obj": 29834,
    "closed/boot.obj": 19931,
    "closed/scorpion.obj": 49997,
    "cad/wingnut.obj": 3047,
    "cad/adis16480.stl": 3672,
    "cad/tray_bottom.stl": 2216,
    "open/mountain.obj": 25600,
    "open/plane_holes.obj": 8519,
    "open/demosthenes_low_res.obj": 8394,
    "open/pizza.obj": 24916,
    "layered/human_neutral.obj": 10475,
    "layered/cycloidal.ply": 21384,
}


def _path(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"needs the real file {name} in ../shared/data, which is not here")
    return path


@pytest.mark.parametrize("name", SCANS)
def test_scans(name: str) -> None:
    points, unique, dropped, extent = SCANS[name]
    cloud = read_cloud(_path(f"scan/{name}"))
    require_reconstructable(cloud)
    summary = inspect(cloud)
    assert (summary.points, summary.dropped) == (points, dropped)
    assert unique is None or summary.unique_points == unique
    np.testing.assert_allclose(summary.extent, extent, rtol=1e-3)
    assert summary.has_colors == (
        name in ("kinect_floor_chair.pcd", "stereo_table_mug.pcd", "facade.pcd")
    )
    assert summary.has_normals == name.endswith("csv")
    assert summary.shift is None
    assert 0.0 < summary.spacing < 0.01 * max(summary.extent)


def test_what_the_notes_say_of_the_facade_and_the_room() -> None:
    facade = inspect(read_cloud(_path("scan/facade.pcd")))
    assert facade.spacing == pytest.approx(6.5, rel=0.1)
    room = inspect(read_cloud(_path("scan/room_scan1.pcd")))
    assert any("50% of the points are exact duplicates" in said for said in room.warnings)


def test_depth_in_steps_is_said() -> None:
    person = inspect(read_cloud(_path("scan/kinect_person.pcd")))
    assert any("exactly flat" in said for said in person.warnings)


@pytest.mark.parametrize("name", MESHES)
def test_vertices_of_meshes(name: str) -> None:
    cloud = read_cloud(_path(name))
    assert len(cloud.points) == MESHES[name]
    assert cloud.dropped == 0


def test_node_transforms_of_a_real_scene() -> None:
    summary = inspect(read_cloud(_path("layered/cesium_milk_truck.glb")))
    assert summary.unique_points == 1840
    np.testing.assert_allclose(summary.extent, (4.869, 2.583, 2.792), rtol=1e-3)
