"""Which format a file is in, by its bytes; names and suffixes are not trusted."""

from __future__ import annotations

from udflow.cloud.formats.obj import looks_like_obj
from udflow.cloud.formats.off import looks_like_off
from udflow.cloud.formats.stl import is_binary_stl, looks_like_ascii_stl
from udflow.cloud.formats.text import looks_like_table
from udflow.errors import UnknownFormat

SNIFFED_BYTES = 64 * 1024
READABLE = "PLY, PCD, LAS, LAZ, E57, XYZ, TXT, CSV, PTS, NPY, NPZ, OBJ, STL, OFF and GLB"

_MAGIC = {
    b"ply\n": "ply",
    b"ply\r": "ply",
    b"LASF": "las",
    b"ASTM-E57": "e57",
    b"glTF": "glb",
    b"\x93NUMPY": "npy",
}
_COMPRESSED = {
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf\x27\x1c": "7-Zip",
    b"Rar!": "RAR",
    b"\x28\xb5\x2f\xfd": "Zstandard",
}
_FOREIGN = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"GIF8": "a GIF image",
    b"II*\0": "a TIFF image",
    b"MM\0*": "a TIFF image",
    b"RIFF": "an image, sound or film",
    b"%PDF": "a PDF document",
    b"Kaydara FBX": "an FBX file, which is not read",
    b"\x89HDF": "an HDF5 file, which is not read",
    b"\x80\x02": "a Python pickle, which is never read",
    b"\x80\x03": "a Python pickle, which is never read",
    b"\x80\x04": "a Python pickle, which is never read",
    b"\x80\x05": "a Python pickle, which is never read",
    b"\xff\xfe": "UTF-16 text; save it as UTF-8 or ASCII",
    b"\xfe\xff": "UTF-16 text; save it as UTF-8 or ASCII",
}
_TEXT_FOREIGN = {"<": "an HTML or XML page", "{": "a JSON or glTF text file; export .glb instead"}


def sniff(head: bytes, size: int) -> str:
    """The format of a file: ply, pcd, las, e57, text, npy, npz, obj, stl, stl-ascii, off or glb.

    Args:
        head: the first SNIFFED_BYTES bytes, or all there are.
        size: bytes in the file.

    Raises:
        UnknownFormat: none of these, with what it is instead where that can be told.
    """
    for magic, name in _MAGIC.items():
        if head.startswith(magic):
            return name
    if head.startswith(b"PK\x03\x04"):
        return _inside_zip(head)
    if is_binary_stl(head, size):
        return "stl"
    _refuse_foreign(head)
    if _looks_like_pcd(head):
        return "pcd"
    if _control_bytes(head):
        raise UnknownFormat(
            f"the file is binary data of no known kind; readable are {READABLE}. "
            "If it is one of them, it is damaged or truncated: export or upload it again"
        )
    return _text_kind(head)


def _inside_zip(head: bytes) -> str:
    """NPZ is a zip of NPY members, so its first member has that suffix."""
    length = int.from_bytes(head[26:28], "little")
    if head[30 : 30 + length].endswith(b".npy"):
        return "npz"
    raise UnknownFormat(
        "the file is a zip archive, whatever its name says; unpack it and send the scan inside"
    )


def _refuse_foreign(head: bytes) -> None:
    for magic, name in _COMPRESSED.items():
        if head.startswith(magic):
            raise UnknownFormat(f"the file is compressed with {name}; unpack it first")
    for magic, name in _FOREIGN.items():
        if head.startswith(magic):
            raise UnknownFormat(f"the file is {name}; readable are {READABLE}")


def _looks_like_pcd(head: bytes) -> bool:
    start = b"\n" + head[:4096]
    fields = b"\nFIELDS " in start or b"\nCOLUMNS " in start
    return start.startswith((b"\n# .PCD", b"\nVERSION")) or (fields and b"\nDATA " in start)


def _control_bytes(head: bytes) -> bool:
    return any(byte < 9 or 13 < byte < 32 for byte in set(head) - {26, 27})


def _text_kind(head: bytes) -> str:
    # Latin-1 takes every byte, so that no encoding of a comment can stand in the way.
    lines = head.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = lines[:-1] if len(lines) > 1 else lines
    if looks_like_ascii_stl(lines):
        return "stl-ascii"
    if looks_like_off(lines):
        return "off"
    if looks_like_obj(lines):
        return "obj"
    if looks_like_table(lines):
        return "text"
    start = head.lstrip()[:1].decode("latin-1")
    what = _TEXT_FOREIGN.get(start, "text, but no table of points")
    raise UnknownFormat(f"the file is {what}; readable are {READABLE}")
