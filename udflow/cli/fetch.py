"""`udflow fetch`: the files of a job on a server."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from udflow.cli.files import STREAM, check_outputs, write_output
from udflow.cli.parser import MESH_FORMATS
from udflow.cli.remote import connected

if TYPE_CHECKING:
    from udflow.client import Client


def run(options: argparse.Namespace) -> None:
    """Download one file."""
    check_outputs(options.output, force=options.force)
    with connected(options) as client:
        fetched(client, options.job, options.what, options)


def fetched(client: Client, job_id: str, what: str, options: argparse.Namespace) -> None:
    """Write a file of the job to the output, whole or not at all."""
    params: dict[str, str] = {}
    if what == "mesh":
        suffix = Path(options.output).suffix.lstrip(".").lower()
        known = suffix if options.output != STREAM and suffix in MESH_FORMATS else "ply"
        params["format"] = options.format or known
    with tempfile.TemporaryFile() as copy:
        client.fetch(job_id, what, copy, params)
        copy.seek(0)
        write_output(
            options.output, lambda file: shutil.copyfileobj(copy, file), force=options.force
        )
