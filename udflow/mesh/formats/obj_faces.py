"""The faces of OBJ files by vertex number; texture and normal numbers do not split vertices."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from udflow.errors import InvalidCloud

Triangle = tuple[int, int, int]


def read_obj_faces(path: Path) -> NDArray[np.int64]:
    """The triangles (f, 3) of an OBJ file; polygons become fans.

    Raises:
        InvalidCloud: a face that names no vertices.
    """
    triangles: list[Triangle] = []
    vertices = 0
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, 1):
            words = line.split("#")[0].split()
            if not words:
                continue
            if words[0] == "v":
                vertices += 1
            elif words[0] == "f":
                try:
                    triangles += _fan(words[1:], vertices)
                except ValueError as error:
                    raise InvalidCloud(
                        f"OBJ: line {number} is no face; export the mesh again"
                    ) from error
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _fan(corners: list[str], vertices: int) -> list[Triangle]:
    """The triangles of one polygon, from 0.

    Numbers in the file count from 1, and negative ones back from the latest vertex.

    Raises:
        ValueError: fewer than three corners, or a corner that is no such number.
    """
    numbers = [int(corner.partition("/")[0]) for corner in corners]
    if len(numbers) < 3 or not all(0 < abs(number) < 2**31 for number in numbers):
        raise ValueError
    a, *rest = [number - 1 if number > 0 else vertices + number for number in numbers]
    return [(a, b, c) for b, c in pairwise(rest)]
