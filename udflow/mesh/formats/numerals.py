"""Many numbers to text at once: digits by whole-array arithmetic instead of a loop over rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

SIGNIFICANT = 16
_MOST_DECIMALS = 22  # the largest power of ten that double precision holds exactly
_GROUP = 4
_ZERO, _POINT, _MINUS = ord("0"), ord("."), ord("-")
# The digits of 0..9999. Byte 0 stands for "nothing here" and is deleted at the end.
_DIGITS = (np.arange(10**_GROUP)[:, None] // 10 ** np.arange(_GROUP)[::-1] % 10 + _ZERO).astype(
    np.uint8
)


def decimals_for(values: NDArray[np.float64]) -> int | None:
    """Decimal places that show 16 digits of the largest value; None where fixed point cannot."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0:
        return 1
    decimals = SIGNIFICANT - 1 - math.floor(math.log10(largest))
    return max(decimals, 1) if -1 < decimals <= _MOST_DECIMALS else None


def fixed_point(values: NDArray[np.float64], decimals: int) -> NDArray[np.uint8]:
    """Numbers in fixed point, without leading or trailing zeros.

    Args:
        values: (n, k), finite, below 1e18 / 10 ** decimals.
        decimals: digits after the point, 1..22; at least one is shown.

    Returns:
        (n, k, width) characters, to be joined by `lines`.
    """
    scaled = np.rint(np.abs(values) * 10.0**decimals).astype(np.int64)
    digits = _digits(scaled, decimals + 1)
    whole, fraction = digits[..., :-decimals], digits[..., -decimals:]
    _blank_leading_zeros(whole)
    _blank_leading_zeros(fraction[..., ::-1])
    point = np.full((*values.shape, 1), _POINT, np.uint8)
    minus = np.where((values < 0.0) & (scaled > 0), _MINUS, 0).astype(np.uint8)[..., None]
    return np.concatenate([minus, whole, point, fraction], axis=-1)


def whole_numbers(values: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Non-negative integers (n, k) as characters (n, k, width)."""
    digits = _digits(values, 1)
    _blank_leading_zeros(digits)
    return digits


def lines(prefix: bytes, *columns: NDArray[np.uint8]) -> bytes:
    """Rows of text: the prefix, then all numbers of all columns between blanks."""
    rows = len(columns[0])
    parts = [np.broadcast_to(np.frombuffer(prefix, np.uint8), (rows, len(prefix)))]
    for column in columns:
        blank = np.full((*column.shape[:2], 1), ord(" "), np.uint8)
        parts.append(np.concatenate([blank, column], axis=-1).reshape(rows, -1))
    parts.append(np.full((rows, 1), ord("\n"), np.uint8))
    return np.concatenate(parts, axis=1).tobytes().translate(None, b"\0")


def _digits(values: NDArray[np.int64], fewest: int) -> NDArray[np.uint8]:
    """All digits of non-negative integers, as many as the largest needs."""
    width = max(fewest, len(str(int(values.max(initial=0)))))
    groups = []
    rest = values
    for _ in range(-(-width // _GROUP)):
        rest, group = np.divmod(rest, 10**_GROUP)
        groups.append(_DIGITS[group])
    joined: NDArray[np.uint8] = np.concatenate(groups[::-1], axis=-1)
    return joined[..., -width:].copy()


def _blank_leading_zeros(digits: NDArray[np.uint8]) -> None:
    """Replace zeros before the first other digit by nothing, but keep the last digit."""
    leading = np.logical_and.accumulate(digits[..., :-1] == _ZERO, axis=-1)
    digits[..., :-1][leading] = 0
