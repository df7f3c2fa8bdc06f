"""One attempt at one job: claim, reconstruct, store, finish."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import redis

from jobs.costs import Costs
from jobs.open_store import open_store
from jobs.previews import Previews
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.spec import Artifact, JobError, JobRecord, JobState
from jobs.store import FileStore
from udflow import faults
from udflow.cloud.formats import read_cloud
from udflow.config import from_dict
from udflow.errors import BadCheckpoint, Canceled, InvalidCloud
from udflow.progress import Progress
from udflow.reconstruct import Reconstruction, reconstruct_steps
from worker.checkpoints import Checkpoints
from worker.cost import remember_cost
from worker.extraction import extract_again
from worker.failure import TooLong, explain
from worker.horse import choose_device, is_to_end, owner_name
from worker.lease import LeaseKeeper
from worker.outputs import Output, outputs_of
from worker.previewer import Previewer
from worker.reporter import JobLost, Reporter

log = logging.getLogger("worker")

_FIT_SHARE = 0.96  # of the whole job; the rest is writing files
_RETRY_S = 0.3
_Answer = TypeVar("_Answer")


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended, for the record."""

    state: Literal[JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED]
    error: JobError | None = None
    outputs: dict[str, Artifact] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def train(job_id: str, attempt: int, settings: Settings) -> None:
    """Run one attempt. Does nothing if the job is not waiting for it (canceled, taken, gone)."""
    # short timeouts: the fit must not wait for a Redis that is away
    with settings.connect(retry=None, socket_timeout=2.0) as connection:
        records = JobRecords(connection, settings.lease_s)
        device = choose_device(settings.device)
        job = _insist(
            lambda: records.claim(job_id, attempt, owner_name(), device), settings.lease_s
        )
        if job is None:
            log.info("%s attempt %d is not waiting any more", job_id, attempt)
            return
        log.info("%s attempt %d begins on %s", job_id, attempt, device)
        faults.hit("worker.claimed")
        store = open_store(settings)
        _note(job, store)
        try:
            with LeaseKeeper(records, job_id, attempt, settings.stall_s) as lease:
                previewer = Previewer(records, Previews(connection), job)
                watch = Watch(Reporter(records, job), previewer, lease, settings.job_timeout_s)
                outcome = _attempt(job, records, store, watch, settings.checkpoint_s)
        except JobLost:
            log.warning("%s attempt %d was taken away", job_id, attempt)
            store.delete_attempt(job_id, attempt)
            return
        except Drained:
            log.info("%s attempt %d is saved for another worker", job_id, attempt)
            store.delete_attempt(job_id, attempt)
            return
        faults.hit("worker.stored")
        _finish(job, outcome, records, store)
        if outcome.state is JobState.SUCCEEDED and attempt == 1:  # others had a start
            remember_cost(job, store, watch.elapsed_s, Costs(connection), outcome.outputs)


class Drained(Exception):
    """The worker is shut down; what there is was saved."""


class Watch:
    """What has to happen between two steps: keep the lease, mind the clock, tell the world."""

    def __init__(
        self, reporter: Reporter, previewer: Previewer, lease: LeaseKeeper, longest_s: float
    ) -> None:
        self._reporter = reporter
        self._previewer = previewer
        self._lease = lease
        self._longest_s = longest_s
        self._saved = False
        self._began = time.monotonic()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the attempt began."""
        return time.monotonic() - self._began

    def enough(self) -> bool:
        """Whether what is fitted so far is to be the result."""
        return self._reporter.enough()

    def saving_now(self) -> bool:
        """Whether the fit is to be saved at once, because this process has to end."""
        self._saved = is_to_end()
        return self._saved

    def step(self, progress: Progress) -> None:
        """Raises TooLong, Canceled, JobLost or Drained when it is time to stop."""
        faults.hit("worker.step")
        self._mind()
        if is_to_end() and (self._saved or progress.step == 0):  # at step 0 all is saved
            raise Drained
        self._reporter.report(progress, _FIT_SHARE * progress.fraction)
        self._previewer.show(progress)

    def file(self, done: int, total: int) -> None:
        """As `step`, while the files of the result are written."""
        self._mind()
        if is_to_end():
            raise Drained
        self._reporter.report_files(done, total, _FIT_SHARE + (1.0 - _FIT_SHARE) * done / total)

    def _mind(self) -> None:
        self._lease.advance()
        if self.elapsed_s > self._longest_s:
            raise TooLong


def _attempt(
    job: JobRecord, records: JobRecords, store: FileStore, watch: Watch, checkpoint_s: float
) -> Outcome:
    try:
        if job.kind == "extract":
            return _extract(job, records, store, watch)
        return _reconstruct(job, store, watch, checkpoint_s)
    except (JobLost, Drained):
        raise
    except Canceled:
        return Outcome(JobState.CANCELED)
    except Exception as error:
        return Outcome(JobState.FAILED, explain(error))


def _reconstruct(job: JobRecord, store: FileStore, watch: Watch, checkpoint_s: float) -> Outcome:
    watch.step(Progress("reading", 0, 1, 0.0, 0.0, 0))
    path = store.scan_path(job.scan_id)
    if not path.exists():
        raise InvalidCloud("the scan of this job was deleted; upload it again and make a new job")
    cloud = read_cloud(path)
    checkpoints = Checkpoints(job, store)

    def begin() -> Reconstruction:
        steps = reconstruct_steps(
            cloud,
            from_dict(job.config),
            job.device or "cpu",
            watch.enough,
            checkpoint=checkpoints.path,
            checkpoint_s=checkpoint_s,
            checkpoint_now=watch.saving_now,
        )
        return _drive(steps, watch, checkpoints)

    result = _gone_on(begin, checkpoints)
    outputs = _store(outputs_of(result), job, store, watch)
    return Outcome(JobState.SUCCEEDED, outputs=outputs, warnings=tuple(result.report["warnings"]))


def _extract(job: JobRecord, records: JobRecords, store: FileStore, watch: Watch) -> Outcome:
    watch.step(Progress("reading", 0, 1, 0.0, 0.0, 0))
    source = records.get(job.source or "")
    files = extract_again(job, source, store, watch.step)
    return Outcome(JobState.SUCCEEDED, outputs=_store(files, job, store, watch))


def _gone_on(begin: Callable[[], Reconstruction], checkpoints: Checkpoints) -> Reconstruction:
    """From the newest checkpoint of an earlier attempt that is sound, else anew."""
    for found in checkpoints.earlier():
        try:
            return begin()
        except BadCheckpoint as error:
            log.warning("%s is passed over: %s", found.name, error)
    checkpoints.forget()
    return begin()


def _drive(
    steps: Generator[Progress, None, Reconstruction], watch: Watch, checkpoints: Checkpoints
) -> Reconstruction:
    while True:
        try:
            progress = next(steps)
        except StopIteration as end:
            result: Reconstruction = end.value
            return result
        checkpoints.share()
        watch.step(progress)


def _store(
    made: Iterable[Output], job: JobRecord, store: FileStore, watch: Watch
) -> dict[str, Artifact]:
    files = [file for file in made if not job.wanted or file.name in job.wanted]
    stored: dict[str, Artifact] = {}
    for done, file in enumerate(files):
        watch.file(done, len(files))
        stored[file.name] = store.put_artifact(job.id, job.attempt, file.name, file.write)
    return stored


def _note(job: JobRecord, store: FileStore) -> None:
    """A full disk is no reason not to begin: the number matters only if Redis is lost as well."""
    try:
        store.note_attempt(job.id, job.attempt)
    except OSError as error:
        log.warning("%s attempt %d is not noted: %s", job.id, job.attempt, error)


def _finish(job: JobRecord, outcome: Outcome, records: JobRecords, store: FileStore) -> None:
    reached = _insist(
        lambda: records.finish(
            job.id,
            job.attempt,
            outcome.state,
            error=outcome.error,
            outputs=outcome.outputs,
            warnings=outcome.warnings,
        ),
        records.lease_s,
    )
    faults.hit("worker.finished")
    log.info("%s attempt %d: %s", job.id, job.attempt, reached or "was taken away")
    if reached is not None:
        store.clear_checkpoints(job.id)
    if reached is JobState.SUCCEEDED or (reached is JobState.CANCELED and _is_kept(job, records)):
        store.keep_only_attempt(job.id, job.attempt)
    else:
        store.delete_attempt(job.id, job.attempt)


def _is_kept(job: JobRecord, records: JobRecords) -> bool:
    """Whether a canceled job keeps a mesh of what was fitted."""
    ended = _insist(lambda: records.get(job.id), records.lease_s)
    return ended is not None and bool(ended.outputs)


def _insist(ask: Callable[[], _Answer], patience_s: float) -> _Answer:
    """Ask Redis again while it is away. All that is asked here is harmless to ask twice."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return ask()
        except (redis.ConnectionError, redis.TimeoutError):
            if time.monotonic() > deadline:
                raise
            time.sleep(_RETRY_S)
