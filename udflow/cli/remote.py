"""What `submit`, `watch`, `fetch` and `query` share when they talk to a server."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from udflow.cli.exits import OutputError, RemoteError, UsageError

if TYPE_CHECKING:
    from udflow.client import Client


@contextlib.contextmanager
def connected(options: argparse.Namespace) -> Iterator[Client]:
    """The client that the options name; its errors as those of the command line."""
    try:
        from udflow.client import Client, JobEnded, ServiceAway, ServiceError
    except ModuleNotFoundError as error:
        raise OutputError(
            "talking to a server needs httpx; install it with: pip install 'udflow[client]'"
        ) from error
    try:
        with Client(options.url, os.environ.get("UDFLOW_KEY")) as client:
            yield client
    except ServiceError as error:
        if error.status == 422:
            raise UsageError(f"the server refused: {error}") from error
        raise RemoteError(f"the server refused: {error}") from error
    except (ServiceAway, JobEnded) as error:
        raise RemoteError(str(error)) from error
