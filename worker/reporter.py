"""From the fit's progress values to the record and the event stream."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import replace
from typing import Any

import redis

from jobs.records import JobRecords
from jobs.spec import JobRecord
from udflow.errors import Canceled
from udflow.progress import Progress
from worker.estimate import TimeLeft

log = logging.getLogger("worker")

PERIOD_S = 0.15  # between two progress events, and between two looks at the cancel flag
_RETRY_S = 1.0  # pause after Redis did not answer
_MOST_UNSENT = 200


class JobLost(Exception):
    """The record has gone to another attempt, or was deleted."""


class Reporter:
    """Publishes one attempt. Changes of stage and rounds of densification are always sent,
    progress between them at most every PERIOD_S.

    While Redis is away the fit goes on: progress is skipped, the rest is kept and sent later.
    """

    def __init__(self, records: JobRecords, job: JobRecord) -> None:
        self._records = records
        self._job = job
        self._left = TimeLeft()
        self._began = time.monotonic()
        self._last: Progress | None = None
        self._next = 0.0
        self._unsent: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_MOST_UNSENT)
        self._enough = False

    def enough(self) -> bool:
        """Whether somebody asked to stop and to keep what is fitted so far."""
        return self._enough

    def report(self, progress: Progress, share: float) -> None:
        """Publish, and look whether to stop. share: of the whole job, 0..1.

        Raises:
            Canceled: somebody asked to stop.
            JobLost: the job is not this attempt's any more.
        """
        values = self._values(progress, share)
        last, self._last = self._last, progress
        if last is None or progress.stage != last.stage:
            self._unsent.append(("stage", values))
        if progress.round > (0 if last is None else last.round):
            self._unsent.append(("densify", values))
        now = time.monotonic()
        if now < self._next and not self._unsent:
            return
        self._next = now + PERIOD_S
        try:
            self._send(values)
            self._look_for_cancel()
        except redis.RedisError as error:
            log.warning("cannot report on %s: %s", self._job.id, error)
            self._next = now + _RETRY_S

    def report_files(self, done: int, total: int, share: float) -> None:
        """As `report`, while the files of the result are written."""
        last = self._last or Progress("exporting", 0, total, 1.0, 0.0, 0)
        self.report(replace(last, stage="exporting", step=done, total=total), share)

    def _values(self, progress: Progress, share: float) -> dict[str, Any]:
        elapsed_s = time.monotonic() - self._began
        return {
            "stage": progress.stage,
            "progress": round(share, 4),
            "step": progress.step,
            "total": progress.total,
            "points": progress.points,
            "round": progress.round,
            "rounds": progress.rounds,
            "loss": progress.loss,
            "elapsed_s": round(elapsed_s, 2),
            "eta_s": self._left.update(elapsed_s, share),
        }

    def _send(self, values: dict[str, Any]) -> None:
        if not self._unsent:
            self._publish("progress", values)
        while self._unsent:
            self._publish(*self._unsent[0])
            self._unsent.popleft()

    def _publish(self, kind: str, values: dict[str, Any]) -> None:
        fields = {
            name: values[name]
            for name in ("stage", "progress", "eta_s", "points", "round", "rounds", "loss")
        }
        if not self._records.update(self._job.id, self._job.attempt, (kind, values), **fields):
            raise JobLost

    def _look_for_cancel(self) -> None:
        asked = self._records.asked_to_stop(self._job.id)
        if asked == "at_once":
            raise Canceled("the job was canceled")
        self._enough = asked == "keep_partial"
