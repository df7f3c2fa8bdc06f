"""The one function that the queue may name."""

from __future__ import annotations

from jobs.settings import Settings
from jobs.signing import load_secret, verify
from worker.trainer import train


def run(job_id: str, attempt: int, mac: str) -> None:
    """Run one attempt at a job, if this service signed it.

    Raises:
        InvalidMac: it did not.
    """
    settings = Settings.from_env()
    verify(load_secret(settings), job_id, attempt, mac)
    train(job_id, attempt, settings)
