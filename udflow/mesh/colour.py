"""Colours of a scan carried over to the vertices of a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from udflow.cloud.point_cloud import PointCloud
from udflow.cloud.srgb import linear_to_srgb8, srgb8_to_linear

_CHUNK = 100_000
# Keeps the weights finite where a vertex lies on a sample; far below any spacing that matters.
_CLOSEST = 1e-9


def transfer_colors(
    vertices: NDArray[np.float64], cloud: PointCloud, *, k: int = 4
) -> NDArray[np.uint8] | None:
    """Colours (v, 3) sRGB for vertices (v, 3) in the frame of the cloud, None if it has none.

    The mean of the k nearest samples, weighted by 1 / distance² and taken in linear light, since
    a mean of sRGB codes is darker than the light it stands for.
    """
    if cloud.colors is None:
        return None
    k = min(k, len(cloud.points))
    light = srgb8_to_linear(cloud.colors)
    tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
    tiny = _CLOSEST * float(np.ptp(cloud.points, axis=0).max()) or 1.0
    colors = np.empty((len(vertices), 3), np.uint8)
    for start in range(0, len(vertices), _CHUNK):
        part = slice(start, start + _CHUNK)
        distance, index = tree.query(vertices[part], k=np.arange(1, k + 1))
        weight = 1.0 / np.square(np.maximum(distance, tiny) / tiny)
        weight /= weight.sum(axis=1, keepdims=True)
        colors[part] = linear_to_srgb8(np.einsum("vk,vkc->vc", weight, light[index]))
    return colors
