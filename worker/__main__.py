"""`python -m worker`: takes jobs from the queue, one at a time, until SIGTERM."""

from __future__ import annotations

import logging
import os
import subprocess
import sys

import redis

from jobs.errors import BadSetting
from jobs.logs import configure
from jobs.settings import Settings
from udflow.compile_loops import load_loops
from udflow.errors import UdflowError
from worker.rq_worker import FitWorker


def _secret_read_apart() -> str:
    """The signing key, by a process of its own.

    Raises:
        BadSetting: it cannot be read; the process has said why.
    """
    command = [sys.executable, "-m", "jobs.signing"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        raise BadSetting("the signing key cannot be read; see above")
    return done.stdout


def main() -> int:
    """The exit code."""
    try:
        configure()
        load_loops()  # once, for all the processes that this one forks
        settings = Settings.from_env()
        if settings.secret is None:
            # read apart: this process forks, and must not have used the bucket before
            os.environ["UDFLOW_SECRET"] = _secret_read_apart()
        FitWorker(Settings.from_env()).work()
    except (UdflowError, redis.ConnectionError) as error:
        logging.getLogger("worker").error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
