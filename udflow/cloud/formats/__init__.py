"""Point clouds from files of many formats, read strictly.

Sizes and counts are checked against the bytes that are there before anything is allocated, and
whatever is wrong is said in words: cause and remedy.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from udflow.cloud.formats.e57 import read_e57
from udflow.cloud.formats.glb import read_glb
from udflow.cloud.formats.las import read_las
from udflow.cloud.formats.npy import read_npy, read_npz
from udflow.cloud.formats.obj import read_obj
from udflow.cloud.formats.off import read_off
from udflow.cloud.formats.pcd import read_pcd
from udflow.cloud.formats.ply import read_ply
from udflow.cloud.formats.sniff import SNIFFED_BYTES, sniff
from udflow.cloud.formats.source import Source
from udflow.cloud.formats.stl import read_ascii_stl, read_binary_stl
from udflow.cloud.formats.text import read_text
from udflow.cloud.point_cloud import PointCloud
from udflow.errors import InvalidCloud

__all__ = ["read_cloud"]

_UTF8_MARK = b"\xef\xbb\xbf"
_READERS: dict[str, Callable[[Source, BinaryIO], PointCloud]] = {
    "ply": lambda source, _: read_ply(source),
    "pcd": lambda source, _: read_pcd(source),
    "las": read_las,
    "e57": lambda source, _: read_e57(source),
    "text": lambda source, _: read_text(source),
    "npy": lambda source, _: read_npy(source),
    "npz": read_npz,
    "obj": lambda source, _: read_obj(source),
    "stl": lambda source, _: read_binary_stl(source),
    "stl-ascii": lambda source, _: read_ascii_stl(source),
    "off": lambda source, _: read_off(source),
    "glb": lambda source, _: read_glb(source),
}


def read_cloud(path: Path) -> PointCloud:
    """The point cloud in a file, in its own units, frame and double precision.

    Reads PLY, PCD, LAS, LAZ, E57, XYZ/TXT/CSV/PTS, NPY, NPZ, and the vertices of OBJ, STL, OFF and
    GLB.
    The format is told by the content, whatever the file is called. Points with undefined or
    infinite coordinates are dropped and counted.

    Raises:
        UnknownFormat: the bytes are of no format that is read.
        InvalidCloud: the file is damaged, truncated, empty, or claims what it does not hold.
        OSError: the file cannot be opened.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        raise InvalidCloud("this is no regular file; give the path of a file with a scan")
    # Overflow and NaN in foreign numbers are expected here: they are dropped and counted.
    with open(path, "rb") as file, np.errstate(all="ignore"):
        try:
            return _read(file, os.fstat(file.fileno()).st_size)
        except MemoryError as error:
            raise InvalidCloud(
                "the scan does not fit into the memory of this machine; thin it out first"
            ) from error


def _read(file: BinaryIO, size: int) -> PointCloud:
    if size == 0:
        raise InvalidCloud("the file is empty; export or upload it again")
    head = file.read(SNIFFED_BYTES)
    start = len(_UTF8_MARK) if head.startswith(_UTF8_MARK) else 0
    kind = sniff(head[start:], size - start)
    source = Source(file, size, kind.removesuffix("-ascii"))
    source.seek(start)
    return _READERS[kind](source, file)
