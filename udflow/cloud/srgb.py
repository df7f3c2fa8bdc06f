"""Between stored colours (sRGB, uint8) and light (linear, 0..1), IEC 61966-2-1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_CODES = np.arange(256) / 255.0
_LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(
    np.float32
)


def srgb8_to_linear(colors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """sRGB (n, 3) uint8 to linear light, 0..1."""
    return _LINEAR[colors]


def linear_to_srgb8(light: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear light (n, 3), clipped to 0..1, to sRGB uint8."""
    clipped = np.clip(np.nan_to_num(light), 0.0, 1.0)
    encoded: NDArray[np.floating] = np.where(
        clipped <= 0.0031308, clipped * 12.92, 1.055 * np.power(clipped, 1.0 / 2.4) - 0.055
    )
    codes: NDArray[np.uint8] = np.rint(encoded * 255.0).astype(np.uint8)
    return codes
