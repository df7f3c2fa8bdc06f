"""`python -m udflow.compile_loops`: compiles all loops now, so that no job has to wait for it.

Takes about half a minute, once per machine and version; afterwards the code is read from
disk in less than a second.
"""

from __future__ import annotations

import numpy as np
import torch

from udflow.cloud.sampled_surface import SampledSurface
from udflow.fields.lattice_loops import find_rows
from udflow.fields.spline_loops import normal_steps
from udflow.fit.linear_loops import products
from udflow.mesh import crosscap_loops, neck_loops, parity_loops
from udflow.mesh.filling import least_filling
from udflow.mesh.topology import edges_of, faces_around
from udflow.picture_loops import draw_discs, draw_triangles


def load_loops() -> None:
    """Compiles every loop, or reads its code from disk, by running it over next to nothing."""
    few = torch.rand(20, 3, generator=torch.Generator().manual_seed(0))
    SampledSurface.of(few).project(few)
    single, whole = np.float32, np.int64
    vectors, numbers = np.zeros((0, 3), single), np.zeros(0, single)
    cells = np.zeros((0, 0, 0), np.int32), np.zeros((0, 512), np.int32), np.zeros((0, 27), single)
    grid = np.zeros(3, single), 1.0, np.zeros(3, whole), *cells
    normal_steps(0, 0, vectors, *grid, 1, vectors, np.zeros((0, 2), whole))
    find_rows(0, 0, np.zeros((0, 3), whole), grid[2], *cells[:2], np.zeros(0, whole))
    columns, runs = np.zeros((0, 9), np.int32), np.zeros((0, 4), np.int32)
    products(0, 0, numbers, columns, runs, 1.0, 1.0, np.zeros((1, 0), single))
    edges, faces = np.zeros((1, 3), single), np.zeros((1, 3, 4), single)
    links = np.zeros((0, 3), whole)
    odd = np.zeros(0, np.uint8)
    parity_loops.believe(0, 0, np.zeros(0, whole), edges, faces, links, edges)
    parity_loops.tell(0, 0, np.zeros(0, whole), edges, links, 1.0, 0.0, faces, odd)
    parity_loops.around(odd, 1, links, links)
    some, ways, lengths = np.zeros(0, whole), np.zeros((0, 1), whole), np.zeros(0)
    surface = lengths, np.zeros((0, 3)), links, some, some, links
    neck_loops.search(0, 0, some, *surface, some, ways, some)
    neck_loops.flare(0, 0, ways, some, *surface, 0, np.zeros((0, 2)), np.zeros(0, np.bool_))
    turns = np.zeros((0, 3), np.bool_)
    crosscap_loops.turning_ways(
        0, 0, some, 0.0, np.zeros((0, 3)), links, turns, ways, some, lengths
    )
    edges_of(links), faces_around(links, 1)
    least_filling(np.zeros((3, 3)))
    places, depth, canvas = np.zeros((0, 3)), np.zeros((0, 0)), np.zeros((0, 0, 3))
    draw_triangles(links, places, places, depth, canvas)
    draw_discs(places, places, 1.0, depth, canvas)


if __name__ == "__main__":
    load_loops()
