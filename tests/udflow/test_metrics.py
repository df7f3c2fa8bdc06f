"""Metrics on meshes whose distances, floors and topology are known."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from shapes import Cube, Shape, Sphere

from udflow.errors import EmptySurface
from udflow.mesh.mesh import Mesh
from udflow.metrics import Evaluation, distances, evaluate, evaluate_protocol
from udflow.metrics.distances import MeshDistance, point_triangle
from udflow.metrics.surface import bounds, face_normals, prepare, sample
from udflow.metrics.topology import spurious_boundary_edges, topology

Array = NDArray[np.float64]


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64))


def cube_mesh() -> Mesh:
    return mesh_of(trimesh.creation.box((1.0, 1.0, 1.0)))


def sphere_mesh(subdivisions: int = 4) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5))


def grid(cells: int = 10, height: float = 0.0) -> Mesh:
    """The square |x|, |y| <= 1/2 of 2 * cells^2 triangles at z = height."""
    line = np.linspace(-0.5, 0.5, cells + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + cells + 1, corner + cells + 2, corner + 1
    return Mesh(vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


def joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + offset for m, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def moved(mesh: Mesh, scale: float, by: tuple[float, float, float]) -> Mesh:
    return Mesh(mesh.vertices * scale + np.array(by), mesh.faces)


def prepared(mesh: Mesh) -> Mesh:
    return prepare(mesh, *bounds(mesh))


def quick(mesh: Mesh, reference: Mesh, samples: int = 20_000) -> Evaluation:
    return evaluate(mesh, reference, samples=samples)


def brute_force(points: Array, mesh: Mesh) -> Array:
    triangles = mesh.vertices[mesh.faces]
    repeated = (np.broadcast_to(p, (len(triangles), 3)) for p in points)
    return np.array([point_triangle(rows, triangles).min() for rows in repeated])


def exact(shape: Shape, points: Array) -> Array:
    return shape.distance(torch.from_numpy(points)).numpy()


# --- exact distances ---------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [0.5, 0.6, 5.0])
def test_distance_to_a_cube_is_that_of_the_cube(spread: float) -> None:
    points = np.random.default_rng(0).uniform(-spread, spread, (5_000, 3))
    np.testing.assert_allclose(MeshDistance(cube_mesh())(points), exact(Cube(), points), atol=1e-12)


def test_distance_to_one_triangle_in_all_seven_regions() -> None:
    triangle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    points = np.array(
        [
            [0.2, 0.2, 3.0],  # above the face
            [-3.0, -4.0, 0.0],  # beyond corner a
            [5.0, 0.0, 3.0],  # beyond corner b
            [0.0, 4.0, 4.0],  # beyond corner c
            [0.5, -2.0, 0.0],  # beyond edge ab
            [1.0, 1.0, 0.0],  # beyond edge bc
            [-2.0, 0.5, 0.0],  # beyond edge ca
        ]
    )
    expected = [3.0, 5.0, 5.0, 5.0, 2.0, math.sqrt(0.5), 2.0]
    np.testing.assert_allclose(MeshDistance(triangle)(points), expected, atol=1e-15)


def test_distance_equals_brute_force_on_slivers_of_all_sizes() -> None:
    """Long, thin, tiny, degenerate: what breaks bounds that trust the shape of a mesh."""
    generator = np.random.default_rng(1)
    corner = generator.uniform(-0.5, 0.5, (600, 1, 3))
    size = 10.0 ** generator.uniform(-4, 0, (600, 1, 1))
    triangles = corner + size * generator.normal(size=(600, 3, 3))
    triangles[::7, 2] = triangles[::7, 1]
    triangles[::50] = triangles[::50, :1]
    soup = Mesh(triangles.reshape(-1, 3), np.arange(1_800).reshape(-1, 3))
    on_it = triangles[:, 0] + 1e-3 * generator.normal(size=(600, 3))
    points = np.concatenate([on_it, generator.uniform(-3, 3, (400, 3))])
    np.testing.assert_allclose(MeshDistance(soup)(points), brute_force(points, soup), atol=1e-13)


def test_distance_where_every_triangle_is_as_near(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the centre of a sphere nothing can be pruned: the descent has to split its points."""
    monkeypatch.setattr(distances, "PAIRS_AT_ONCE", 3_000)
    sphere = sphere_mesh(3)
    points = np.random.default_rng(0).normal(scale=1e-6, size=(50, 3))
    np.testing.assert_allclose(
        MeshDistance(sphere)(points), brute_force(points, sphere), rtol=1e-14
    )


def test_distance_to_edges_only() -> None:
    """A face (a, b, b) is a segment; a mesh may consist of nothing else."""
    edge = Mesh(np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[0, 1, 1]]))
    points = np.array([[1.0, 1, 0], [3, 0, 0], [-3, 4, 0]])
    np.testing.assert_allclose(MeshDistance(edge)(points), [1, 1, 5])


# --- sampled measures and their floors ---------------------------------------------------------


def test_a_mesh_against_itself_scores_the_floor_and_no_excess() -> None:
    result = quick(sphere_mesh(), sphere_mesh())
    assert result.accuracy.maximum == pytest.approx(0, abs=1e-9)
    assert result.completeness.maximum == pytest.approx(0, abs=1e-9)
    assert abs(result.chamfer.excess) < 5 * result.chamfer.floor_sd + 1e-3 * result.chamfer.floor
    assert result.chamfer.value_sd > 0  # reseeded samples, not one and the same
    assert abs(result.f_score_005.excess) < 0.005
    assert abs(result.normal_consistency.excess) < 0.001


def test_the_chamfer_floor_is_half_the_root_of_area_per_sample() -> None:
    area = face_normals(prepared(sphere_mesh()))[1].sum()
    result = quick(sphere_mesh(), sphere_mesh())
    assert result.chamfer.floor == pytest.approx(1e3 * 0.5 * math.sqrt(area / 20_000), rel=0.02)


def test_the_f_score_floor_is_the_chance_to_meet_a_sample() -> None:
    """1 - exp(-pi rho tau^2) with rho samples per area, away from borders."""
    area = face_normals(prepared(sphere_mesh()))[1].sum()
    result = quick(sphere_mesh(), sphere_mesh())
    expected = 1 - math.exp(-math.pi * 20_000 / area * 0.01**2)
    assert result.f_score_010.floor == pytest.approx(expected, abs=0.01)


def test_an_offset_plane_is_off_by_its_offset() -> None:
    result = quick(grid(height=0.003), grid())
    assert result.accuracy.mean == pytest.approx(3.0)
    assert result.completeness.p95 == pytest.approx(3.0)
    assert result.completeness.maximum == pytest.approx(3.0)
    # an offset delta gives CD = delta + d0 exp(x^2) erfc(x) with x = delta sqrt(pi rho)
    x = 0.003 * math.sqrt(math.pi * 20_000)
    expected = 3.0 + 1e3 * 0.5 / math.sqrt(20_000) * math.exp(x**2) * math.erfc(x)
    assert result.chamfer.value == pytest.approx(expected, rel=0.02)


def test_a_missing_half_shows_in_completeness_only() -> None:
    whole = grid(20)
    half = Mesh(whole.vertices, whole.faces[whole.vertices[whole.faces, 0].max(axis=1) <= 0])
    result = quick(half, whole)
    assert result.accuracy.maximum == pytest.approx(0, abs=1e-9)
    assert result.completeness.maximum == pytest.approx(500, rel=0.01)
    assert result.completeness.mean == pytest.approx(125, rel=0.03)  # half of it is 250 off
    # both ways count: 125 from the reference, next to nothing from the mesh
    assert result.chamfer.value == pytest.approx(125 / 2, rel=0.08)
    # half of the reference is found by all of the mesh: 2 * 1 * 1/2 / (3/2)
    assert result.f_score_010.value == pytest.approx(2 / 3, abs=0.05)


def test_perpendicular_faces_do_not_agree_in_their_normals() -> None:
    upright = Mesh(grid().vertices[:, [2, 0, 1]], grid().faces)
    assert quick(upright, grid()).normal_consistency.value == pytest.approx(0, abs=1e-12)


def test_units_and_frame_do_not_matter() -> None:
    here = quick(sphere_mesh(2), sphere_mesh(4))
    there = quick(
        moved(sphere_mesh(2), 250.0, (512_000, 5_403_000, 300)),
        moved(sphere_mesh(4), 250.0, (512_000, 5_403_000, 300)),
    )
    assert there.extent == pytest.approx(250.0)
    assert there.accuracy.mean == pytest.approx(here.accuracy.mean, rel=1e-4)
    assert there.chamfer.value == pytest.approx(here.chamfer.value, rel=1e-2)
    assert there.topology == here.topology


def test_the_reference_alone_decides_the_scale() -> None:
    """Far debris of the prediction is its error, not the ruler."""
    debris = moved(grid(1), 0.01, (9.0, 0.0, 0.0))
    result = quick(joined(sphere_mesh(), debris), sphere_mesh())
    assert result.extent == pytest.approx(1.0)
    assert result.completeness.maximum == pytest.approx(0, abs=1e-9)
    assert result.topology.components == 2


def test_doubled_faces_do_not_count_twice() -> None:
    doubled = joined(sphere_mesh(3), sphere_mesh(3))
    flipped = Mesh(doubled.vertices, np.concatenate([doubled.faces, doubled.faces[:, ::-1]]))
    assert len(prepared(flipped).faces) == len(sphere_mesh(3).faces)
    single, twice = quick(sphere_mesh(3), sphere_mesh(3)), quick(flipped, flipped)
    assert twice.chamfer.floor == pytest.approx(single.chamfer.floor, rel=0.01)


def test_the_same_seed_gives_the_same_figures_and_json_holds_them() -> None:
    first, second = (quick(sphere_mesh(2), sphere_mesh(3), 2_000) for _ in range(2))
    assert first == second
    values = json.loads(json.dumps(first.to_dict()))
    chamfer = values["chamfer"]
    assert chamfer["excess"] == pytest.approx(chamfer["value"] - chamfer["floor"])
    assert values["topology"]["watertight"] is True


def test_excess_may_be_negative() -> None:
    """A perfect mesh lies above and below its floor by chance, and nobody clips that."""
    excess = [evaluate(grid(), grid(), samples=500, seed=k).chamfer.excess for k in range(8)]
    assert min(excess) < 0 < max(excess)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), "no faces"),
        (Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), "one point"),
        (Mesh(np.array([[0.0, 0, 0], [np.nan, 0, 0], [1, 1, 1]]), np.array([[0, 1, 2]])), "finite"),
        (Mesh(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0, 1, 1]])), "without area"),
        (Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]])), "area"),
    ],
)
def test_a_mesh_without_surface_is_refused_in_words(mesh: Mesh, words: str) -> None:
    with pytest.raises(EmptySurface, match=words):
        evaluate(mesh, grid())
    with pytest.raises(EmptySurface, match=words):
        evaluate(grid(), mesh)


def test_a_floor_of_one_sample_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        evaluate(grid(), grid(), seeds=1)
    with pytest.raises(ValueError, match="at least 100"):
        evaluate(grid(), grid(), samples=10)


def test_samples_are_even_by_area() -> None:
    """Two squares of area 1 and 1/4, one of many triangles, one of two."""
    both = joined(grid(1), moved(grid(20), 0.5, (0, 0, 3)))
    points = sample(both, 100_000, np.random.default_rng(0)).points
    assert np.mean(points[:, 2] == 0) == pytest.approx(0.8, abs=0.01)
    low = points[points[:, 2] == 0]
    assert low[:, :2].mean(axis=0) == pytest.approx([0, 0], abs=0.01)
    assert low[:, :2].var(axis=0) == pytest.approx([1 / 12, 1 / 12], rel=0.02)


def test_a_polyhedron_inside_a_sphere_is_off_by_the_sagitta() -> None:
    """Exact distances against the true sphere, found without our code."""
    coarse, fine = sphere_mesh(2), sphere_mesh(6)
    points = sample(coarse, 20_000, np.random.default_rng(0)).points
    true_mean = 1e3 * exact(Sphere(), points).mean()
    assert quick(coarse, fine).accuracy.mean == pytest.approx(true_mean, rel=0.05)


# --- topology ----------------------------------------------------------------------------------


def test_topology_of_closed_shapes() -> None:
    cube = topology(prepared(cube_mesh()))
    assert (cube.vertices, cube.faces, cube.euler_number, cube.components) == (8, 12, 2, 1)
    assert cube.watertight
    torus = topology(prepared(mesh_of(trimesh.creation.torus(0.35, 0.15))))
    assert torus.euler_number == 0
    assert torus.watertight
    assert (torus.boundary_edges, torus.boundary_loops, torus.nonmanifold_edges) == (0, 0, 0)


def test_topology_of_a_square_with_a_hole() -> None:
    square = grid(6)
    middle = square.vertices[square.faces].mean(axis=1)
    pierced = Mesh(square.vertices, square.faces[np.abs(middle[:, :2]).max(axis=1) > 1 / 6])
    found = topology(prepared(pierced))
    assert (found.boundary_edges, found.boundary_loops) == (4 * 6 + 4 * 2, 2)
    assert (found.euler_number, found.components, found.watertight) == (0, 1, False)


def test_two_parts_are_two_components() -> None:
    found = topology(prepared(joined(cube_mesh(), moved(cube_mesh(), 0.5, (0, 0, 0)))))
    assert (found.components, found.euler_number, found.watertight) == (2, 4, True)


def test_three_faces_on_an_edge_are_not_manifold() -> None:
    vertices = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    book = Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    found = topology(prepared(book))
    assert (found.nonmanifold_edges, found.boundary_edges, found.watertight) == (1, 6, False)


def test_a_face_turned_round_is_not_watertight() -> None:
    cube = cube_mesh()
    turned = Mesh(cube.vertices, np.concatenate([cube.faces[:1, ::-1], cube.faces[1:]]))
    found = topology(prepared(turned))
    assert found.boundary_edges == 0
    assert not found.watertight


def test_a_soup_of_triangles_is_welded_even_across_rounding() -> None:
    cube = cube_mesh()
    corners = cube.vertices[cube.faces].reshape(-1, 3)
    corners = corners + 1e-9 * np.random.default_rng(0).normal(size=corners.shape)
    soup = Mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert topology(prepared(soup)) == topology(prepared(cube))


def test_only_borders_far_from_true_borders_are_spurious() -> None:
    whole = prepared(grid(10))
    middle = whole.vertices[whole.faces].mean(axis=1)
    inner = np.abs(middle[:, :2]).max(axis=1) < 0.1
    pierced = Mesh(whole.vertices, whole.faces[~inner])
    assert spurious_boundary_edges(whole, whole) == 0
    assert spurious_boundary_edges(pierced, whole) == 8
    assert spurious_boundary_edges(whole, prepared(cube_mesh())) == 40


# --- published protocols -----------------------------------------------------------------------


def test_cars_protocol_measures_in_the_units_of_the_reference() -> None:
    small = evaluate_protocol(grid(height=0.01), grid(), "capudf-cars", samples=20_000)
    large = evaluate_protocol(
        moved(grid(height=0.01), 10, (0, 0, 0)), moved(grid(), 10, (0, 0, 0)), "capudf-cars",
        samples=20_000,
    )  # fmt: skip
    assert small.figures["chamfer-L2 x 1e4"] == pytest.approx(1.0, rel=0.2)
    ratio = large.figures["chamfer-L2 x 1e4"] / small.figures["chamfer-L2 x 1e4"]
    assert ratio == pytest.approx(100)
    assert small.figures["f-score 0.005"] == 0
    assert large.figures["f-score 0.01"] == 0


def test_srb_protocol_divides_by_the_largest_offset_from_the_mean() -> None:
    """A square of half width 1/2 is doubled: CD x 10 of an offset 0.1 is 2."""
    result = evaluate_protocol(grid(height=0.1), grid(), "capudf-srb", samples=30_000)
    assert result.figures["chamfer-L1 x 10"] == pytest.approx(2.0, rel=0.01)
    cloud = sample(grid(), 30_000, np.random.default_rng(5)).points
    by_points = evaluate_protocol(grid(height=0.1), cloud, "capudf-srb", samples=30_000)
    assert by_points.figures["chamfer-L1 x 10"] == pytest.approx(2.0, rel=0.01)
    assert "normal consistency" not in by_points.figures


def test_scene_protocol_crops_to_the_scan_and_flatters_normals() -> None:
    scan = sample(grid(), 30_000, np.random.default_rng(5)).points
    with_debris = joined(grid(), moved(grid(), 1, (0, 0, 2)))
    result = evaluate_protocol(with_debris, grid(), "capudf-3dscene", scan=scan, samples=20_000)
    assert result.figures["chamfer-L1"] < 0.005
    with pytest.raises(ValueError, match="give the scan"):
        evaluate_protocol(grid(), grid(), "capudf-3dscene")
    with pytest.raises(EmptySurface, match="same frame"):
        evaluate_protocol(grid(), grid(), "capudf-3dscene", scan=scan + 5)


def test_scene_protocol_drops_faces_that_only_begin_at_the_scan() -> None:
    scan = sample(grid(), 30_000, np.random.default_rng(5)).points
    spike = Mesh(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 5]]), np.array([[0, 1, 2]]))
    result = evaluate_protocol(
        joined(grid(), spike), grid(), "capudf-3dscene", scan=scan, samples=20_000
    )
    assert result.figures["chamfer-L1"] < 0.005


def test_normal_consistency_per_component_is_never_smaller() -> None:
    tilted = Mesh(
        grid().vertices @ np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]), grid().faces
    )
    scan = sample(tilted, 30_000, np.random.default_rng(5)).points
    upright = Mesh(
        grid().vertices @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]), grid().faces
    )
    plain = evaluate_protocol(tilted, upright, "capudf-cars", samples=5_000)
    scene = evaluate_protocol(tilted, upright, "capudf-3dscene", scan=scan, samples=5_000)
    # the normals are (-0.6, 0, 0.8) and (-0.8, 0, 0.6)
    assert plain.figures["normal consistency"] == pytest.approx(0.96)
    assert scene.figures["normal consistency"] == pytest.approx(0.96)
    mirrored = Mesh(upright.vertices * [-1, 1, 1], upright.faces)
    plain = evaluate_protocol(tilted, mirrored, "capudf-cars", samples=5_000)
    scene = evaluate_protocol(tilted, mirrored, "capudf-3dscene", scan=scan, samples=5_000)
    assert plain.figures["normal consistency"] == pytest.approx(0.0, abs=1e-9)
    assert scene.figures["normal consistency"] == pytest.approx(0.96)


def test_an_unknown_protocol_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="capudf-srb"):
        evaluate_protocol(grid(), grid(), "shapenet")
