"""Flat sheets of triangles with unit edges, and tubes between their cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from udflow.mesh.draft import Draft
from udflow.mesh.topology import edges_of, parts, side_pairs

Points = NDArray[np.float64]
Faces = NDArray[np.int64]


def sheet(side: int, height: float = 0.0) -> tuple[Points, Faces]:
    """A square of side² cells in the plane z = height, facing up."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    vertices = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return vertices, faces.reshape(-1, 3)


def cell(side: int, column: int, row: int) -> NDArray[np.int64]:
    """The four vertices of a cell of a sheet, in the order of its faces."""
    first = column * (side + 1) + row
    return np.array([first, first + side + 1, first + side + 2, first + 1])


def without_cell(faces: Faces, corners: NDArray[np.int64]) -> Faces:
    return faces[~np.isin(faces, corners).all(axis=1)]


def between(one: NDArray[np.int64], two: NDArray[np.int64]) -> Faces:
    """Triangles between two loops; both bound missing faces that face along the tube."""
    after_one, after_two = np.roll(one, -1), np.roll(two, -1)
    return np.concatenate(
        [np.stack([one, after_one, two], axis=1), np.stack([after_one, after_two, two], axis=1)]
    )


def tower(vertices: Points, faces: Faces, corners: NDArray[np.int64], height: int) -> Draft:
    """A sheet with a closed tower, one cell wide, on one of its cells."""
    faces = [without_cell(faces, corners)]
    base = vertices[corners]
    for level in range(1, height + 1):
        ring = len(vertices) + np.arange(4)
        vertices = np.concatenate([vertices, base + np.array([0.0, 0.0, level])])
        faces.append(between(corners, ring))
        corners = ring
    faces.append(corners[[[0, 1, 2], [0, 2, 3]]])
    return draft(vertices, np.concatenate(faces))


def two_sheets(side: int, gap: float, *, closed: bool) -> tuple[Points, Faces]:
    """Two sheets, the lower one facing down; joined along their rims if closed."""
    top, faces = sheet(side, gap)
    bottom = sheet(side)[0]
    every = [faces, faces[:, ::-1] + len(top)]
    if closed:
        rim = np.concatenate(
            [
                np.arange(side) * (side + 1),
                side * (side + 1) + np.arange(side),
                (side + 1) ** 2 - 1 - np.arange(side) * (side + 1),
                side - np.arange(side),
            ]
        )
        every.append(between(rim + len(top), rim))
    return np.concatenate([top, bottom]), np.concatenate(every)


def with_tube(vertices: Points, faces: Faces, corners: NDArray[np.int64]) -> Draft:
    """Two sheets with a cell of both removed and the edges of the gaps joined."""
    below = corners + len(vertices) // 2
    faces = without_cell(without_cell(faces, corners), below)
    return draft(vertices, np.concatenate([faces, between(corners, below)]))


def draft(vertices: Points, faces: Faces) -> Draft:
    return Draft(vertices, faces, np.ones(len(vertices), dtype=bool))


def samples_on(vertices: Points, faces: Faces, spacing: float) -> Points:
    """Random points of the surface, one on each spacing²."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    random = np.random.default_rng(0)
    chosen = random.choice(len(faces), int(area.sum() / spacing**2), p=area / area.sum())
    u, v = np.sqrt(random.random((1, len(chosen), 1))), random.random((1, len(chosen), 1))
    points = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]
    return np.asarray(points[0])


def euler(mesh: Draft) -> int:
    return len(np.unique(mesh.faces)) - len(edges_of(mesh.faces).ends) + len(mesh.faces)


def pieces(mesh: Draft) -> int:
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return len(np.unique(parts(side_pairs(faces.reshape(-1, 3)), len(used))))


def borders(mesh: Draft) -> int:
    """Pieces of the border."""
    edges = edges_of(mesh.faces)
    used, ends = np.unique(edges.ends[edges.count == 1], return_inverse=True)
    return len(np.unique(parts(ends.reshape(-1, 2), len(used)))) if len(used) else 0


def consistent(mesh: Draft) -> bool:
    """Whether no edge has more than two faces, and neighbours agree in orientation."""
    directed = side_pairs(mesh.faces)
    return bool(edges_of(mesh.faces).count.max() <= 2) and len(np.unique(directed, axis=0)) == len(
        directed
    )
