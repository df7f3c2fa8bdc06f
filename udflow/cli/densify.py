"""`udflow densify`: the scan with points added along its fitted surface."""

from __future__ import annotations

import argparse

from udflow.cli.files import check_outputs, print_json, write_output
from udflow.cli.fitting import check_streams, config_from, fitted, say


def run(options: argparse.Namespace) -> None:
    """Reconstruct a scan and write its densified points."""
    config = config_from(options)
    check_outputs(options.output, force=options.force)
    check_streams(options, options.output)
    result = fitted(options, config)
    from udflow.mesh.export import write_points

    write_output(
        options.output, lambda file: write_points(result.points, file), force=options.force
    )
    points = result.report["points"]
    if options.json:
        print_json({"output": options.output, "points": points})
    say(
        options,
        [
            f"{options.output}: {points['densified']} points, from {points['unique']} distinct "
            f"ones, {points['rounds']} rounds"
        ],
    )
