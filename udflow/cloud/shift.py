"""Large coordinates: what to subtract before single precision is used."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FAR = 1e5
THIN = 1e-3


def suggested_shift(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[float, float, float] | None:
    """A round vector near the centre of a bounding box, or None where none is needed.

    Single precision holds 7 digits, so map coordinates lose decimetres in it. A shift is needed
    where a coordinate is beyond 1e5, or the extent is below a thousandth of the distance from the
    origin. It is rounded to the power of ten above the extent, so that people can read it.

    Args:
        low, high: (3,) corners of the box.
    """
    centre, extent = 0.5 * low + 0.5 * high, float((high - low).max())
    far = max(float(np.abs(low).max()), float(np.abs(high).max())) > FAR
    thin = extent < THIN * float(np.abs(centre).max())
    if not (far or thin):
        return None
    step = 10.0 ** math.ceil(math.log10(extent)) if extent > 0.0 else 1.0
    # + 0.0 turns -0.0 into 0.0
    x, y, z = (np.rint(centre / step) * step + 0.0).tolist()
    return (x, y, z) if any((x, y, z)) else None
