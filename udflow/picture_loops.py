"""Drawing into a z-buffer, as compiled loops."""

from __future__ import annotations

import math

from udflow.compiled import Array, compiled

_EDGE = 1e-9  # pixels on an edge belong to both of its triangles, so that no gap opens


@compiled
def draw_triangles(faces: Array, corners: Array, light: Array, depth: Array, canvas: Array) -> None:
    """Draws triangles where they are nearer than what is there.

    Args:
        faces: (f, 3) int64.
        corners: (v, 3) column, row and nearness, in pixels.
        light: (v, 3) linear colours.
        depth: (height, width) nearness so far, changed in place.
        canvas: (height, width, 3) light so far, changed in place.
    """
    height, width = depth.shape
    for face in range(len(faces)):
        a, b, c = faces[face]
        ax, ay, bx, by = corners[a, 0], corners[a, 1], corners[b, 0], corners[b, 1]
        cx, cy = corners[c, 0], corners[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        top = max(0, math.ceil(min(ay, by, cy) - 0.5))
        bottom = min(height - 1, math.floor(max(ay, by, cy) - 0.5))
        left = max(0, math.ceil(min(ax, bx, cx) - 0.5))
        right = min(width - 1, math.floor(max(ax, bx, cx) - 0.5))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                of_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                of_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                of_a = 1.0 - of_b - of_c
                if min(of_a, of_b, of_c) < -_EDGE:
                    continue
                near = of_a * corners[a, 2] + of_b * corners[b, 2] + of_c * corners[c, 2]
                if near > depth[row, column]:
                    depth[row, column] = near
                    for i in range(3):
                        canvas[row, column, i] = (
                            of_a * light[a, i] + of_b * light[b, i] + of_c * light[c, i]
                        )


@compiled
def draw_discs(places: Array, light: Array, radius: float, depth: Array, canvas: Array) -> None:
    """Draws discs of `radius` pixels round (n, 3) places; the rest as in `draw_triangles`."""
    height, width = depth.shape
    reach = int(radius)
    for point in range(len(places)):
        middle, across = math.floor(places[point, 1]), math.floor(places[point, 0])
        for row in range(max(0, middle - reach), min(height, middle + reach + 1)):
            for column in range(max(0, across - reach), min(width, across + reach + 1)):
                away = math.hypot(row - middle, column - across)
                if away <= radius and places[point, 2] > depth[row, column]:
                    depth[row, column] = places[point, 2]
                    for i in range(3):
                        canvas[row, column, i] = light[point, i]
