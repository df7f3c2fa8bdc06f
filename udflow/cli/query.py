"""`udflow query`: unsigned distances from a stored field."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import TYPE_CHECKING, Any

from udflow.cli.exits import UsageError
from udflow.cli.files import STREAM, check_outputs, opened_input, print_json, write_output
from udflow.cli.fitting import check_streams, checked_device
from udflow.cli.remote import connected
from udflow.errors import BadField, InvalidQuery

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from udflow.fields.unsigned import FieldAnswer, UnsignedDistanceField


def run(options: argparse.Namespace) -> None:
    """Answer all points and write the answers as .npy."""
    check_outputs(options.output, force=options.force)
    check_streams(options, options.output)
    if options.field == STREAM:
        raise UsageError("the field must be a file; only the points may come from standard input")
    import numpy as np

    points = _points(options.points)
    start = time.monotonic()
    if is_job(options.field):
        answer = _remote(points, options)
    else:
        field = _field(options.field, checked_device(options.device))
        start = time.monotonic()
        answer = field.query(points)
    seconds = time.monotonic() - start
    rows = _rows(answer, options)
    write_output(
        options.output, lambda file: np.save(file, rows, allow_pickle=False), force=options.force
    )
    _report(answer, seconds, options)


def is_job(name: str) -> bool:
    """Whether the field is that of a job on a server."""
    return name.startswith("job_") and not os.path.exists(name)


def _remote(points: NDArray[Any], options: argparse.Namespace) -> Any:
    with connected(options) as client:
        return client.query(
            options.field, points, gradients=options.gradients, closest=options.closest
        )


def _points(name: str) -> NDArray[Any]:
    from udflow.cloud.formats import read_cloud

    with opened_input(name) as path:
        cloud = read_cloud(path)
    if cloud.dropped:
        raise InvalidQuery(
            f"{name}: {cloud.dropped} points have a coordinate that is not finite, so the answers "
            "would not match the rows; remove them first"
        )
    return cloud.points


def _field(name: str, device: str) -> UnsignedDistanceField:
    from pathlib import Path

    from udflow.fields.storage import load_field

    try:
        return load_field(Path(name), device)
    except BadField as error:
        raise BadField(f"{name}: {error}") from error
    except OSError as error:
        reason = (error.strerror or "no such file").lower()
        raise BadField(f"{name}: {reason}") from error


def _rows(answer: FieldAnswer, options: argparse.Namespace) -> NDArray[Any]:
    """(n,) distances; records with named fields where more is wanted, as over HTTP."""
    import numpy as np

    columns: list[Any] = [("distance", "<f8")]
    if options.gradients:
        columns.append(("gradient", "<f4", (3,)))
    if options.closest:
        columns.append(("closest", "<f8", (3,)))
    if len(columns) == 1:
        return answer.distance
    rows = np.empty(len(answer.distance), np.dtype([*columns, ("valid", "?")]))
    for name in rows.dtype.names or ():
        rows[name] = getattr(answer, name)
    return rows


def _report(answer: FieldAnswer, seconds: float, options: argparse.Namespace) -> None:
    count, outside = len(answer.distance), int((~answer.valid).sum())
    figures = {
        "output": options.output,
        "points": count,
        "outside_trained_box": outside,
        "mean": float(answer.distance.mean()) if count else None,
        "maximum": float(answer.distance.max()) if count else None,
        "seconds": seconds,
    }
    if options.json:
        print_json(figures)
    else:
        remark = f", {outside} outside the trained box" if outside else ""
        sys.stderr.write(f"{count} distances in {seconds:.2f} s{remark}\n")
