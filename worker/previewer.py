"""Shows a running fit to those who watch: bounded in rate, size and cost."""

from __future__ import annotations

import logging
import time

import redis

from jobs.previews import MAX_BYTES, Kind, Previews
from jobs.records import JobRecords
from jobs.spec import JobRecord
from udflow.progress import Look, Progress
from worker.frames import mesh_frame, points_frame

log = logging.getLogger("worker")

PERIOD_S = 1.0  # between two frames
RESOLUTION = 64  # of the meshes, in cells along the largest extent
_REST = 4.0  # times the cost of the last mesh, before the next: a fifth of the time at most
_ATTEMPTS = 1 << 20  # sequences of one attempt, so that the next one's are higher


class Previewer:
    """Draws what is new: the cloud after each round, a coarse mesh after each fit.

    Meshes cost time, so they are made only while somebody watches. What the limits leave out is
    made up for by the next frame, which shows everything up to then.
    """

    def __init__(self, records: JobRecords, previews: Previews, job: JobRecord) -> None:
        self._records = records
        self._previews = previews
        self._job = job
        self._sequence = (job.attempt % 4096) * _ATTEMPTS
        self._points_shown = -1
        self._fits_shown = 0
        self._next = 0.0
        self._next_mesh = 0.0

    def show(self, progress: Progress) -> None:
        """Send a frame if there is something new to see and it is time for it."""
        look, now = progress.look, time.monotonic()
        if look is None or now < self._next:
            return
        try:
            if progress.points != self._points_shown:
                self._show_points(look, progress)
            elif look.fits > self._fits_shown and now >= self._next_mesh:
                self._show_mesh(look, progress)
        except redis.RedisError as error:
            log.warning("cannot show %s: %s", self._job.id, error)
            self._next = time.monotonic() + PERIOD_S

    def _show_points(self, look: Look, progress: Progress) -> None:
        cloud = look.cloud()
        self._send("points", points_frame(cloud, self._number(), progress.rounds), progress)
        self._points_shown = progress.points

    def _show_mesh(self, look: Look, progress: Progress) -> None:
        self._next = time.monotonic() + PERIOD_S
        if not self._previews.is_watched(self._job.id):
            return
        began = time.monotonic()
        mesh = look.mesh(RESOLUTION)
        self._fits_shown = look.fits
        self._next_mesh = time.monotonic() + _REST * (time.monotonic() - began)
        if mesh is not None:
            frame = mesh_frame(mesh, self._number(), progress.round, progress.rounds)
            if frame is not None:
                self._send("mesh", frame, progress)

    def _number(self) -> int:
        self._sequence += 1
        return self._sequence

    def _send(self, kind: Kind, frame: bytes, progress: Progress) -> None:
        """The frame first: whoever reads the event finds it, or a newer one."""
        if len(frame) > MAX_BYTES:
            return
        self._previews.put(self._job.id, kind, frame)
        notice = {
            "kind": kind,
            "sequence": self._sequence,
            "bytes": len(frame),
            "points": progress.points,
            "round": progress.round,
            "rounds": progress.rounds,
        }
        self._records.update(self._job.id, self._job.attempt, ("preview", notice))
        self._next = time.monotonic() + PERIOD_S
