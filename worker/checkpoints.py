"""What an attempt leaves for the next one to go on with."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

from jobs.spec import JobRecord
from jobs.store import FileStore

log = logging.getLogger("worker")


class Checkpoints:
    """The checkpoint of one attempt, and those of the attempts before it.

    Every attempt writes under its own name: one that was lost and does not know it yet changes
    nothing that the next one reads.
    """

    def __init__(self, job: JobRecord, store: FileStore) -> None:
        self._job, self._store = job, store
        self.path: Path = store.checkpoint_path(job.id, job.attempt)
        self._shared: int | None = None

    def earlier(self) -> Iterator[Path]:
        """Checkpoints of earlier attempts, the newest first; each is put in place of this
        attempt's own when it is asked for."""
        for attempt in self._store.checkpoints(self._job.id, before=self._job.attempt):
            found = self._store.checkpoint_path(self._job.id, attempt)
            self.forget()
            os.link(found, self.path)
            log.info(
                "%s attempt %d goes on from attempt %d", self._job.id, self._job.attempt, attempt
            )
            yield found

    def forget(self) -> None:
        """Remove this attempt's own."""
        self.path.unlink(missing_ok=True)

    def share(self) -> None:
        """Bring it to where other workers find it, if it was written since the last call."""
        try:
            written = self.path.stat().st_ino
        except FileNotFoundError:
            return
        if written != self._shared:
            self._shared = written
            self._store.share_checkpoint(self._job.id, self._job.attempt)
