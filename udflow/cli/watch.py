"""`udflow watch`: the progress of a job on a server, until its end."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from udflow.cli.progress import shown_progress
from udflow.cli.remote import connected
from udflow.progress import Progress

if TYPE_CHECKING:
    from udflow.client import Client


def run(options: argparse.Namespace) -> None:
    """Show what happens; a job that ends without a result is an error."""
    with connected(options) as client:
        watched(client, options.job, options.after, options)


def watched(client: Client, job_id: str, after: str | None, options: argparse.Namespace) -> None:
    """Follow a job to its end.

    Raises:
        JobEnded: it has no result.
    """
    with shown_progress(options.quiet or options.json) as listener:
        for event in client.events(job_id, after):
            if options.json and not options.quiet:
                sys.stdout.write(json.dumps(event) + "\n")
                sys.stdout.flush()
            elif event["data"].get("stage") and "progress" in event["data"]:
                listener(_progress(event["data"]))
    client.wait(job_id)


def _progress(data: dict[str, Any]) -> Progress:
    return Progress(
        stage=data["stage"],
        step=data.get("step", 0),
        total=data.get("total", 1),
        fraction=data["progress"],
        elapsed_s=data.get("elapsed_s", 0.0),
        points=data.get("points") or 0,
        round=data.get("round", 0),
        rounds=data.get("rounds", 0),
        loss=data.get("loss"),
    )
