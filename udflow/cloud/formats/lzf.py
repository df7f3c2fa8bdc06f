"""The LZF compression of PCD files (Marc Lehmann's LibLZF format)."""

from __future__ import annotations


def lzf_decompress(data: bytes, size: int) -> bytearray | None:
    """The `size` bytes that were compressed to `data`, or None where `data` is damaged.

    The format: a control byte below 32 announces that many plus one literal bytes. Any other holds
    a length in its upper three bits (7: one more byte of length follows) and the upper five bits
    of a distance whose lower eight follow; copy length + 2 bytes from distance + 1 bytes back.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end:
            control = data[at]
            if control < 32:
                stop = at + control + 2
                if stop > end:
                    return None
                out += data[at + 1 : stop]
                at = stop
            else:
                length = (control >> 5) + 2
                if length == 9:
                    at += 1
                    length += data[at]
                start = len(out) - ((control & 31) << 8) - data[at + 1] - 1
                at += 2
                if start < 0:
                    return None
                piece = out[start : start + length]
                if len(piece) < length:  # the copy overlaps what it writes: it repeats
                    piece = (piece * (length // len(piece) + 1))[:length]
                out += piece
            if len(out) > size:
                return None
    except IndexError:
        return None
    return out if len(out) == size else None
