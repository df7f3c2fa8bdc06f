"""`udflow inspect`: what a scan is made of."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import TYPE_CHECKING

from udflow.cli.files import opened_input, print_json

if TYPE_CHECKING:
    from udflow.cloud.inspection import CloudSummary


def run(options: argparse.Namespace) -> None:
    """Read a scan and describe it."""
    from udflow.cloud.formats import read_cloud
    from udflow.cloud.inspection import inspect, require_reconstructable

    with opened_input(options.scan) as path:
        cloud = read_cloud(path)
        require_reconstructable(cloud)
    summary = inspect(cloud)
    if options.json:
        print_json(dataclasses.asdict(summary))
    else:
        sys.stdout.write("".join(f"{line}\n" for line in _lines(summary)))


def _lines(summary: CloudSummary) -> list[str]:
    dropped = f", {summary.dropped} dropped as not finite" if summary.dropped else ""
    carries = [
        name
        for name, there in (("colours", summary.has_colors), ("normals", summary.has_normals))
        if there
    ]
    lines = [
        f"format   {summary.format}" + (f", with {' and '.join(carries)}" if carries else ""),
        f"points   {summary.points}, {summary.unique_points} distinct{dropped}",
        f"low      {_numbers(summary.low)}",
        f"high     {_numbers(summary.high)}",
        f"extent   {_numbers(summary.extent)}",
        f"spacing  {summary.spacing:.6g}",
        f"noise    {summary.noise:.6g} at most",
    ]
    if summary.shift is not None:
        lines.append(f"shift    {_numbers(summary.shift)} in single-precision files")
    return lines + [f"warning  {text}" for text in summary.warnings]


def _numbers(vector: tuple[float, float, float]) -> str:
    return "  ".join(f"{value:.9g}" for value in vector)
