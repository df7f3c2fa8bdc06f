"""E57 files written plainly by the rules of ASTM E2807, with damage where it is asked for."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from cloud_files import COLORS, POINTS

_CONTENT = 1020


@dataclass(frozen=True)
class Stream:
    """A column: its element in the prototype, and (value, bits) of the packed numbers."""

    element: str
    bits: bytes


@dataclass
class Scan:
    """One scan. lines: further XML; claimed: points that the XML claims."""

    streams: Sequence[Stream]
    points: int
    lines: str = ""
    claimed: int | None = None
    codecs: str = ""
    attributes: Mapping[str, object] = field(default_factory=dict)


def crc32c(data: bytes) -> int:
    """Bit by bit."""
    state = 0xFFFFFFFF
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = state >> 1 ^ (0x82F63B78 if state & 1 else 0)
    return state ^ 0xFFFFFFFF


def floats(name: str, values: Sequence[float], precision: str = "double") -> Stream:
    """A column of floats, as they are."""
    kind = "<f4" if precision == "single" else "<f8"
    element = f'<{name} type="Float" precision="{precision}"/>'
    return Stream(element, np.asarray(values, kind).tobytes())


def whole(
    name: str, values: Sequence[int], low: int, high: int, scale: float = 0.0, offset: float = 0.0
) -> Stream:
    """A column of whole numbers in as many bits as their limits need; scaled unless scale is 0."""
    bits, packed = (high - low).bit_length(), 0
    for i, value in enumerate(values):
        packed |= (int(value) - low) << (i * bits)
    kind = f'"ScaledInteger" scale="{scale}" offset="{offset}"' if scale else '"Integer"'
    element = f'<{name} type={kind} minimum="{low}" maximum="{high}"/>'
    return Stream(element, packed.to_bytes(-(-bits * len(values) // 8), "little"))


def e57(*scans: Scan, packet: int = 1500, doctype: str = "", pages: bool = True) -> bytes:
    """The file. packet: bytes of a stream in one packet; pages: False gives the bare content."""
    content = bytearray(48)
    listed = []
    for scan in scans:
        place = _physical(len(content))
        content += _section(scan, len(content), packet)
        listed.append(_described(scan, place))
    xml = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n{doctype}<e57Root type="Structure" '
        'xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0">'
        f'<data3D type="Vector">{"".join(listed)}</data3D></e57Root>'
    ).encode()
    begins = _physical(len(content))
    content += xml
    content += bytes(-len(content) % _CONTENT)
    length = len(content) // _CONTENT * 1024
    content[:48] = struct.pack("<8sIIQQQQ", b"ASTM-E57", 1, 0, length, begins, len(xml), 1024)
    return sealed(bytes(content)) if pages else bytes(content)


def sealed(content: bytes) -> bytes:
    """The content with the checksums of its pages, highest byte first."""
    pages = (content[at : at + _CONTENT] for at in range(0, len(content), _CONTENT))
    return b"".join(page + crc32c(page).to_bytes(4, "big") for page in pages)


def cartesian(low: int = -(2**20), high: int = 2**20) -> list[Stream]:
    """POINTS as singles, as scaled numbers of odd width, and as doubles; then COLORS."""
    x, y, z = POINTS.T.astype(float)
    steps = np.rint(y / 1e-5).astype(int).tolist()
    columns = [
        floats("cartesianX", x.tolist(), "single"),
        whole("cartesianY", steps, low, high, 1e-5),
        floats("cartesianZ", z.tolist()),
    ]
    names = ("colorRed", "colorGreen", "colorBlue")
    return columns + [
        whole(name, COLORS[:, axis].tolist(), 0, 255) for axis, name in enumerate(names)
    ]


def plain() -> bytes:
    """One scan of POINTS and COLORS."""
    return e57(Scan(cartesian(), len(POINTS)))


def _physical(logical: int) -> int:
    return logical // _CONTENT * 1024 + logical % _CONTENT


def _section(scan: Scan, start: int, packet: int) -> bytes:
    """Header, an index packet, then data packets with a piece of each stream, and an empty one."""
    body = struct.pack("<BBH", 0, 0, 15) + bytes(12)
    longest = max(len(stream.bits) for stream in scan.streams)
    for at in range(0, longest, packet):
        pieces = [stream.bits[at : at + packet] for stream in scan.streams]
        lengths = struct.pack(f"<{len(pieces)}H", *map(len, pieces))
        data = struct.pack("<H", len(pieces)) + lengths + b"".join(pieces)
        data += bytes(-len(data) % 4)
        body += struct.pack("<BBH", 1, 0, len(data) + 3) + data
    body += struct.pack("<BBH", 2, 0, 3)
    return struct.pack("<B7xQQQ", 1, 32 + len(body), _physical(start + 32), 0) + body


def _described(scan: Scan, place: int) -> str:
    count = scan.points if scan.claimed is None else scan.claimed
    said = {"fileOffset": place, "recordCount": count} | dict(scan.attributes)
    attributes = " ".join(f'{name}="{value}"' for name, value in said.items())
    prototype = "".join(stream.element for stream in scan.streams)
    return (
        f'<vectorChild type="Structure">{scan.lines}<points type="CompressedVector" {attributes}>'
        f'<prototype type="Structure">{prototype}</prototype>'
        f'<codecs type="Vector">{scan.codecs}</codecs></points></vectorChild>'
    )
