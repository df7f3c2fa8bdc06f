"""Named places at which tests let a process die or a disk be full. Without effect otherwise.

UDFLOW_FAULTS names a folder; a file in it with the name of a place arms that place for one time.
An empty file kills the process there as `kill -9` does, one that holds the name of an error of the
operating system ("ENOSPC") raises that error. Files of places that exist are in `PLACES`.
"""

from __future__ import annotations

import errno
import os
import signal
from pathlib import Path

PLACES = (
    "checkpoint.begun",  # nothing written
    "checkpoint.written",  # whole, under its temporary name
    "checkpoint.renamed",  # visible
    "worker.claimed",  # the job is this attempt's, nothing is done
    "worker.step",  # between two steps of the fit
    "file.written",  # any file of the store, whole, under its temporary name
    "file.renamed",  # visible
    "worker.stored",  # all files of the result are there, the record says nothing of them
    "worker.finished",  # the record has ended, nothing is tidied up
    "worker.settled",  # the worker that waits has requeued the job and offered it to nobody
    "reaper.requeued",  # the same for the reaper
    "submit.written",  # the manifest is on disk, there is no record
    "submit.recorded",  # there is a record, it is offered to nobody
    "scan.moved",  # bytes are in place, there is no manifest
    "scan.written",  # the manifest is there, the bytes cannot be found by their digest
    "upload.appended",  # a piece is on disk, its sender has no answer
)


def hit(place: str) -> None:
    """Says that execution is at `place`.

    Raises:
        OSError: a test wants this error here.
    """
    folder = os.environ.get("UDFLOW_FAULTS")
    if not folder:
        return
    armed = Path(folder, place)
    try:
        wanted = armed.read_text().strip()
        armed.unlink()  # one time, whoever comes first
    except FileNotFoundError:
        return
    if not wanted:
        os.kill(os.getpid(), signal.SIGKILL)
    number = getattr(errno, wanted)
    raise OSError(number, os.strerror(number), place)
