"""Follow a job over a websocket that may break: after each break it goes on where it was.

    python examples/watch_job.py job_01... --url http://127.0.0.1:8000

UDFLOW_KEY holds the key of a service that asks for one.
"""

import argparse
import json
import os
import time
from collections.abc import Iterator
from typing import Any

from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import connect


def events(url: str, job_id: str, headers: dict[str, str]) -> Iterator[dict[str, Any]]:
    """Every event of the job once, in order, from its beginning to its end."""
    address = f"{url.replace('http', 'ws', 1)}/v1/jobs/{job_id}/events"
    seen = "0-0"
    while True:
        try:
            with connect(f"{address}?after={seen}", additional_headers=headers) as socket:
                for message in map(json.loads, socket):
                    if "id" not in message:
                        continue  # a heartbeat
                    seen = message["id"]
                    yield message
                    if message["type"] == "end":
                        return
            return  # closed with 1000: everything was sent before
        except (ConnectionClosedError, OSError):
            time.sleep(1.0)


def main(job_id: str, url: str) -> None:
    """Print what happens."""
    key = os.environ.get("UDFLOW_KEY")
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    for event in events(url, job_id, headers):
        data = event["data"]
        if event["type"] == "gap":
            print("some events are no longer kept; going on from the state as it is")
        elif event["type"] in ("stage", "progress", "densify"):
            print(f"{data['progress']:4.0%} {data['stage']}, {data['points']} points")
        elif event["type"] in ("state", "end"):
            print(data["state"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("job")
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    options = parser.parse_args()
    main(options.job, options.url)
