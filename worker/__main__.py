"""`python -m worker`: takes jobs from the queue, one at a time, until SIGTERM."""

from __future__ import annotations

import logging
import sys

import redis

from jobs.logs import configure
from jobs.settings import Settings
from udflow.errors import UdflowError
from worker.rq_worker import FitWorker


def main() -> int:
    """The exit code."""
    try:
        configure()
        FitWorker(Settings.from_env()).work()
    except (UdflowError, redis.ConnectionError) as error:
        logging.getLogger("worker").error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
