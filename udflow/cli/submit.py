"""`udflow submit`: a scan to a server, which reconstructs it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from udflow.cli.fetch import fetched
from udflow.cli.files import check_outputs, opened_input, print_json
from udflow.cli.fitting import config_from
from udflow.cli.remote import connected
from udflow.cli.watch import watched
from udflow.config import to_dict


def run(options: argparse.Namespace) -> None:
    """Send the scan, start the job, print its id; with -o wait for the mesh."""
    config: dict[str, Any] = to_dict(config_from(options))
    if options.output:
        check_outputs(options.output, force=options.force)
    with opened_input(options.scan) as path, connected(options) as client:
        if options.estimate:
            print_json(client.estimate(path, preset=options.preset, config=config))
            return
        name = Path(options.scan).name
        job = client.submit(
            path, preset=options.preset, config=config, metadata={"name": name[:512]}
        )
        if options.json:
            print_json(job)
        else:
            sys.stdout.write(f"{job['id']}\n")
            sys.stdout.flush()
        if options.output:
            watched(client, job["id"], None, options)
            fetched(client, job["id"], "mesh", options)
