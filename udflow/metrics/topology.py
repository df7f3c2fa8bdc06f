"""What a mesh is made of: borders, pieces, handles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from udflow.mesh.mesh import Mesh
from udflow.metrics.distances import MeshDistance

FAR_FROM_A_TRUE_BORDER = 0.02  # of the largest extent


@dataclass(frozen=True)
class Topology:
    """Counted after welding (see `surface.prepare`).

    Attributes:
        boundary_edges: edges with exactly one face.
        boundary_loops: connected pieces of the boundary; loops that touch in a vertex are one.
        nonmanifold_edges: edges with more than two faces.
        components: pieces of the surface connected by shared vertices.
        euler_number: vertices - edges + faces.
        watertight: every edge has exactly two faces, oriented alike.
    """

    vertices: int
    faces: int
    boundary_edges: int
    boundary_loops: int
    nonmanifold_edges: int
    components: int
    euler_number: int
    watertight: bool


@dataclass(frozen=True)
class _Edges:
    """ends (e, 2), smaller index first; faces (e,) and forward (e,) count the faces on an edge
    and those that run along it from the smaller to the larger index."""

    ends: NDArray[np.int64]
    faces: NDArray[np.int64]
    forward: NDArray[np.int64]


def topology(mesh: Mesh) -> Topology:
    """Topology of a prepared mesh (every vertex used, every face once)."""
    edges = _edges(mesh)
    border = boundary(mesh)
    return Topology(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        boundary_edges=len(border),
        boundary_loops=_pieces(border, np.unique(border)),
        nonmanifold_edges=int((edges.faces > 2).sum()),
        components=_pieces(edges.ends, np.arange(len(mesh.vertices))),
        euler_number=len(mesh.vertices) - len(edges.ends) + len(mesh.faces),
        watertight=bool(((edges.faces == 2) & (edges.forward == 1)).all()),
    )


def spurious_boundary_edges(mesh: Mesh, reference: Mesh) -> int:
    """Boundary edges of `mesh` whose middle is far from every boundary of `reference`.

    Far is 0.02 in the frame of both meshes, normalised to largest extent 1. Where the reference
    is closed, every boundary edge is spurious.
    """
    border = boundary(mesh)
    true_border = boundary(reference)
    if len(border) == 0 or len(true_border) == 0:
        return len(border)
    segments = Mesh(reference.vertices, np.column_stack([true_border, true_border[:, 1]]))
    distance = MeshDistance(segments)(mesh.vertices[border].mean(axis=1))
    return int((distance > FAR_FROM_A_TRUE_BORDER).sum())


def boundary(mesh: Mesh) -> NDArray[np.int64]:
    """Boundary edges (e, 2) as pairs of vertex numbers."""
    edges = _edges(mesh)
    return np.asarray(edges.ends[edges.faces == 1])


def _edges(mesh: Mesh) -> _Edges:
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = directed[:, 0] < directed[:, 1]
    key = directed.min(axis=1) * np.int64(len(mesh.vertices)) + directed.max(axis=1)
    distinct, label, faces = np.unique(key, return_inverse=True, return_counts=True)
    ends = np.column_stack(np.divmod(distinct, len(mesh.vertices)))
    count = np.bincount(label, weights=forward, minlength=len(distinct))
    return _Edges(ends=ends, faces=faces, forward=count.astype(np.int64))


def _pieces(edges: NDArray[np.int64], nodes: NDArray[np.int64]) -> int:
    """Connected pieces of the graph with these edges (e, 2) and (sorted) nodes."""
    if len(nodes) == 0:
        return 0
    start, end = np.searchsorted(nodes, edges).T
    shape = (len(nodes), len(nodes))
    graph = coo_array((np.ones(len(edges), bool), (start, end)), shape=shape)
    return int(connected_components(graph, directed=False)[0])
