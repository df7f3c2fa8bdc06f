"""Pictures: what is in front is seen, all of it fits, and a decoder reads the file."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from udflow.mesh.mesh import Mesh
from udflow.picture import Image, View, mesh_picture, points_picture
from udflow.png import png

FRONT = View((0.0, 0.0, 0.0), 2.0, azimuth=0.0, elevation=0.0)
RED, BLUE = (255, 0, 0), (0, 0, 255)


def wall(y: float, half: float, color: tuple[int, int, int]) -> Mesh:
    """A square across the view, seen from -Y."""
    corners = np.array([[-half, y, -half], [half, y, -half], [half, y, half], [-half, y, half]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corners, faces, np.tile(np.array(color, np.uint8), (4, 1)))


def both(first: Mesh, second: Mesh) -> Mesh:
    assert first.colors is not None
    assert second.colors is not None
    return Mesh(
        np.vstack([first.vertices, second.vertices]),
        np.vstack([first.faces, second.faces + len(first.vertices)]),
        np.vstack([first.colors, second.colors]),
    )


def hue(image: Image, row: int, column: int) -> str:
    pixel = image[row, column]
    return "nothing" if pixel[3] == 0 else "red" if pixel[0] > pixel[2] else "blue"


@pytest.mark.parametrize("red_first", [True, False])
def test_the_nearer_surface_hides_the_farther_one(red_first: bool) -> None:
    near, far = wall(-0.5, 0.3, RED), wall(0.5, 0.8, BLUE)
    image = mesh_picture(both(near, far) if red_first else both(far, near), (100, 100), FRONT)
    assert hue(image, 50, 50) == "red"
    assert hue(image, 50, 22) == "blue"
    assert hue(image, 50, 4) == "nothing"


def test_both_sides_of_a_surface_are_lit_alike() -> None:
    mesh = wall(0.0, 0.8, RED)
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.colors)
    assert np.array_equal(mesh_picture(mesh, (60, 60)), mesh_picture(turned, (60, 60)))


def test_a_surface_is_covered_without_holes() -> None:
    image = mesh_picture(wall(0.0, 0.8, RED), (200, 200), FRONT)
    inside = image[30:170, 30:170]
    assert (inside[..., 3] == 255).all()


def test_up_is_up() -> None:
    points = np.array([[0.0, 0.0, 0.8], [-0.1, 0.0, 0.8], [0.1, 0.0, 0.8]])
    rows = np.nonzero(points_picture(points, size=(100, 100), view=FRONT)[..., 3])[0]
    assert rows.max() < 30


@pytest.mark.parametrize("stretch", [(1.0, 1.0, 1.0), (9.0, 1.0, 0.2), (0.1, 0.1, 5.0)])
def test_all_of_a_cloud_is_in_the_picture(stretch: tuple[float, float, float]) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (3000, 3)) * stretch + [5e5, 5e6, 100.0]
    covered = points_picture(points, size=(160, 120))[..., 3] > 0
    border = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
    assert covered.any()
    assert not border.any()


def test_a_single_point_is_drawn_in_the_middle() -> None:
    covered = np.argwhere(points_picture(np.array([[3.0, 4.0, 5.0]]), size=(50, 50))[..., 3])
    assert np.abs(covered.mean(axis=0) - 24.5).max() < 1.5


def test_png_holds_exactly_the_pixels() -> None:
    image = np.random.default_rng(0).integers(0, 256, (7, 5, 4)).astype(np.uint8)
    file = png(image)
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", file[16:24]) == (5, 7)
    start = file.index(b"IDAT")
    size = struct.unpack(">I", file[start - 4 : start])[0]
    data = file[start + 4 : start + 4 + size]
    assert struct.unpack(">I", file[start + 4 + size :][:4])[0] == zlib.crc32(b"IDAT" + data)
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(7, -1)
    assert (rows[:, 0] == 0).all()
    assert np.array_equal(rows[:, 1:].reshape(7, 5, 4), image)


def test_an_image_without_opacity_is_refused() -> None:
    with pytest.raises(ValueError, match="3 channels is no RGBA image"):
        png(np.zeros((2, 2, 3), np.uint8))
