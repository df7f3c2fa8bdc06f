"""Answers about query points as they leave: JSON, .npy, or bare numbers."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from service.udf_input import Wanted, Wire

if TYPE_CHECKING:  # brings torch, which the service loads with the first query
    from udflow.fields.unsigned import FieldAnswer

MEDIA_TYPES: dict[Wire, str] = {
    "json": "application/json",
    "npy": "application/x-npy",
    "raw": "application/octet-stream",
}


def json_answer(answer: FieldAnswer, wanted: Wanted) -> bytes:
    """One JSON object; rows in the order of the points."""
    body: dict[str, Any] = {
        "count": len(answer.distance),
        "distance": answer.distance.tolist(),
        "valid": answer.valid.tolist(),
    }
    if wanted.gradients:
        body["gradient"] = answer.gradient.tolist()
    if wanted.closest:
        body["closest"] = answer.closest.tolist()
    return json.dumps(body, allow_nan=False).encode()


class Stream(Protocol):
    """A binary reply that is written chunk by chunk, its length known before."""

    def head(self, rows: int) -> bytes:
        """What comes before the rows."""
        ...

    def rows(self, answer: FieldAnswer) -> bytes:
        """The rows of one chunk."""
        ...

    def length(self, rows: int) -> int:
        """Bytes of the whole reply."""
        ...

    def headers(self, rows: int) -> dict[str, str]:
        """What a reader has to know beside the bytes."""
        ...


@dataclass(frozen=True)
class NpyStream:
    """A .npy file: (n,) float64 distances, or records where more than the distance is wanted."""

    wanted: Wanted

    @property
    def dtype(self) -> np.dtype[Any]:
        if self.wanted == Wanted():
            return np.dtype("<f8")
        columns: list[Any] = [("distance", "<f8")]
        if self.wanted.gradients:
            columns.append(("gradient", "<f4", (3,)))
        if self.wanted.closest:
            columns.append(("closest", "<f8", (3,)))
        return np.dtype([*columns, ("valid", "?")])

    def head(self, rows: int) -> bytes:
        file = io.BytesIO()
        descr = np.lib.format.dtype_to_descr(self.dtype)
        header = {"descr": descr, "fortran_order": False, "shape": (rows,)}
        np.lib.format.write_array_header_1_0(file, header)
        return file.getvalue()

    def rows(self, answer: FieldAnswer) -> bytes:
        dtype = self.dtype
        if dtype.names is None:
            return bytes(answer.distance.astype(dtype).tobytes())
        rows = np.empty(len(answer.distance), dtype)
        for name in dtype.names:
            rows[name] = getattr(answer, name)
        return bytes(rows.tobytes())

    def length(self, rows: int) -> int:
        return len(self.head(rows)) + rows * self.dtype.itemsize

    def headers(self, rows: int) -> dict[str, str]:
        return {}


@dataclass(frozen=True)
class RawStream:
    """Bare little-endian numbers, one row of columns a point.

    dtype: of the query points, "<f4" or "<f8".
    """

    wanted: Wanted
    dtype: np.dtype[Any]

    @property
    def columns(self) -> list[str]:
        names = ["distance"]
        if self.wanted.gradients:
            names += ["gradient_x", "gradient_y", "gradient_z"]
        if self.wanted.closest:
            names += ["closest_x", "closest_y", "closest_z"]
        return names if self.wanted == Wanted() else [*names, "valid"]

    def head(self, rows: int) -> bytes:
        return b""

    def rows(self, answer: FieldAnswer) -> bytes:
        columns: list[NDArray[Any]] = [answer.distance[:, None]]
        if self.wanted.gradients:
            columns.append(answer.gradient)
        if self.wanted.closest:
            columns.append(answer.closest)
        if self.wanted != Wanted():
            columns.append(answer.valid[:, None])
        return np.hstack(columns).astype(self.dtype).tobytes()

    def length(self, rows: int) -> int:
        return rows * len(self.columns) * self.dtype.itemsize

    def headers(self, rows: int) -> dict[str, str]:
        return {
            "X-Shape": f"{rows},{len(self.columns)}",
            "X-Dtype": "float32" if self.dtype.itemsize == 4 else "float64",
            "X-Columns": ",".join(self.columns),
        }


def stream_for(wire: Wire, wanted: Wanted, points: np.dtype[Any]) -> Stream:
    """The binary form of a reply to points of this dtype."""
    if wire == "npy":
        return NpyStream(wanted)
    return RawStream(wanted, np.dtype("<f4" if points == np.dtype("<f4") else "<f8"))
