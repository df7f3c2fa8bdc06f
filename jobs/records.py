"""The job records: the truth about every job, changed only by compare-and-set."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import redis

from jobs import keys, scripts
from jobs.errors import IdempotencyConflict, QueueFull, TooManyJobs, UnknownId
from jobs.fields import flat, initial_fields, record_of, texts
from jobs.ids import first_id
from jobs.spec import Artifact, JobError, JobRecord, JobSpec, JobState

MAX_CRASHES = 3
_POISON = JobError(
    "poison",
    f"the worker died {MAX_CRASHES} times on this job, so it is not tried again; a smaller "
    "extract.resolution or densify.target_points may help",
)
_WAITED = JobError(
    "expired", "no worker was free before the longest allowed wait was over; submit again later"
)


@dataclass(frozen=True)
class Idempotency:
    """A caller's key for one request, and the digest of the request's body."""

    key: str
    fingerprint: str

    @classmethod
    def of(cls, key: str, body: Any) -> Idempotency:
        """From the header's value and any JSON values."""
        text = json.dumps(body, sort_keys=True)
        return cls(key, hashlib.sha256(text.encode()).hexdigest())


@dataclass(frozen=True)
class Created:
    """replayed: the job existed already, because the same request came twice."""

    record: JobRecord
    replayed: bool


@dataclass(frozen=True)
class Snapshot:
    """A record, and the id of the last event that it already includes."""

    record: JobRecord
    last_event: str


@dataclass(frozen=True)
class Page:
    """Newest first. next: pass as `before` for the following page; None at the end."""

    records: tuple[JobRecord, ...]
    next: str | None


class JobRecords:
    """The records in one Redis.

    connection: with text answers (`Settings.connect`); lease_s: how long a claim lasts unrenewed.
    All methods raise redis.exceptions.RedisError when Redis does not answer.
    """

    def __init__(self, connection: redis.Redis, lease_s: float = 20.0) -> None:
        self._redis: Any = connection  # typed for bytes; ours answers with text
        self.lease_s = lease_s
        self._scripts: dict[str, Any] = {}

    # asked by the service

    def create(
        self,
        spec: JobSpec,
        idempotency: Idempotency | None = None,
        queue_limit: int | None = None,
        caller_limit: int | None = None,
        attempt: int = 1,
    ) -> Created:
        """Store a new job as queued. The same spec or idempotency key again changes nothing.

        attempt: above 1 for a job that Redis forgot while it may still have been running.

        Raises:
            IdempotencyConflict: the key came before with another body.
            QueueFull: queue_limit jobs wait already.
            TooManyJobs: the spec's caller has caller_limit unfinished ones.
            UnknownId: the job that the key made has been deleted since.
        """
        fields = initial_fields(spec, attempt)
        digest = idempotency.fingerprint if idempotency else ""
        key = hashlib.sha256(idempotency.key.encode()).hexdigest() if idempotency else "none"
        outcome, job_id = self._run(
            scripts.CREATE,
            spec.id,
            digest,
            "" if queue_limit is None else queue_limit,
            fields["created_at"],
            "" if caller_limit is None else caller_limit,
            *flat(fields),
            extra_key=keys.idempotency(key),
        )
        if outcome == "conflict":
            raise IdempotencyConflict(
                f"this idempotency key was used with another request, which made {job_id}; "
                "use a new key for a new request"
            )
        if outcome == "full":
            raise QueueFull(f"{queue_limit} jobs are waiting already; try again later")
        if outcome == "many":
            raise TooManyJobs(
                f"{caller_limit} jobs of this key are waiting or running; try again later"
            )
        record = self.get(job_id)
        if record is None:
            raise UnknownId(f"this request made {job_id}, which has been deleted since")
        return Created(record, outcome == "replayed")

    def get(self, job_id: str) -> JobRecord | None:
        """The record, None if there is none (any more)."""
        fields = self._redis.hgetall(keys.job(job_id))
        return record_of(fields) if "state" in fields else None

    def snapshot(self, job_id: str) -> Snapshot | None:
        """The record and its place in the event stream, read at one moment."""
        with self._redis.pipeline(transaction=True) as pipe:
            pipe.hgetall(keys.job(job_id))
            pipe.xrevrange(keys.events(job_id), count=1)
            fields, last = pipe.execute()
        if "state" not in fields:
            return None
        return Snapshot(record_of(fields), last[0][0] if last else "0-0")

    def is_gone(self, some_id: str) -> bool:
        """Whether a job or scan existed and was deleted or has expired."""
        return bool(self._redis.exists(keys.tombstone(some_id)))

    def mark_gone(self, some_id: str) -> None:
        """Remember that a scan was deleted or has expired."""
        self._redis.set(keys.tombstone(some_id), "1", ex=keys.TOMBSTONE_LIFE_S)

    def page(
        self,
        limit: int = 50,
        before: str | None = None,
        *,
        state: JobState | None = None,
        scan_id: str | None = None,
        created_after: float | None = None,
        of: str | None = None,
    ) -> Page:
        """Jobs, newest first. before: `Page.next` of the previous page; times in Unix seconds;
        of: only this caller's."""
        oldest = "-" if created_after is None else f"[{first_id('job', created_after)}"
        found: list[JobRecord] = []
        while True:
            newest = "+" if before is None else f"({before}"
            ids = self._redis.zrevrangebylex(keys.INDEX, newest, oldest, start=0, num=100)
            for record in self._fetch(ids):
                wanted = state in (None, record.state) and scan_id in (None, record.scan_id)
                if wanted and of in (None, record.caller):
                    if len(found) == limit:
                        return Page(tuple(found), found[-1].id)
                    found.append(record)
            if len(ids) < 100:
                return Page(tuple(found), None)
            before = ids[-1]

    def request_cancel(self, job_id: str, *, keep_partial: bool = False) -> JobRecord | None:
        """Ask to stop. A waiting job is canceled at once, a running one becomes canceling, a
        finished one stays. The record afterwards, None if there is none.

        keep_partial: store a mesh of what is fitted so far. A later call without it stops sooner.
        """
        self._run(scripts.CANCEL, job_id, int(keep_partial))
        return self.get(job_id)

    def delete(self, job_id: str, force: bool = False) -> bool:
        """Remove the record and its events, leaving a tombstone. False: it is still queued or
        running and force was not given."""
        return bool(
            self._run(
                scripts.DELETE,
                job_id,
                keys.TOMBSTONE_LIFE_S,
                int(force),
                extra_key=keys.tombstone(job_id),
            )
        )

    def unfinished_with(self, scan_id: str) -> list[str]:
        """Ids of waiting and running jobs for a scan."""
        found = self.queued() + self.active()
        return [record.id for record in found if record.scan_id == scan_id]

    def queue_position(self, job_id: str) -> int | None:
        """1 for the next to start; None when it does not wait."""
        rank = self._redis.zrank(keys.QUEUED, job_id)
        return None if rank is None else int(rank) + 1

    def queue_length(self) -> int:
        """How many jobs wait."""
        return int(self._redis.zcard(keys.QUEUED))

    # asked by the worker; False or None means: the job is not this attempt's any more

    def claim(
        self, job_id: str, attempt: int, owner: str | None = None, device: str = "cpu"
    ) -> JobRecord | None:
        """Start a queued job. owner: names the process, so that it may ask again when the answer
        was lost; a fresh name by default."""
        name = owner or secrets.token_hex(8)
        if not self._run(scripts.CLAIM, job_id, attempt, name, self.lease_s, device):
            return None
        return self.get(job_id)

    def update(
        self,
        job_id: str,
        attempt: int,
        event: tuple[str, Mapping[str, Any]] | None = None,
        **fields: Any,
    ) -> bool:
        """Change fields of a running job, with an event (type, data) in the same step."""
        kind, data = (event[0], json.dumps(event[1])) if event else ("", "")
        return bool(self._run(scripts.UPDATE, job_id, attempt, kind, data, *flat(texts(fields))))

    def asked_to_stop(self, job_id: str) -> Literal["no", "at_once", "keep_partial"]:
        """Whether a running job was asked to stop, and then to keep what is fitted so far."""
        state, keeps = self._redis.hmget(keys.job(job_id), "state", "keep_partial")
        if state != JobState.CANCELING:
            return "no"
        return "keep_partial" if keeps == "1" else "at_once"

    def renew_lease(self, job_id: str, attempt: int) -> bool:
        """Keep the job for another lease_s."""
        return bool(self._run(scripts.RENEW, job_id, attempt, self.lease_s))

    def finish(
        self,
        job_id: str,
        attempt: int,
        state: Literal[JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED],
        *,
        error: JobError | None = None,
        outputs: Mapping[str, Artifact] | None = None,
        warnings: Iterable[str] = (),
    ) -> JobState | None:
        """End a running job. The state that was reached: canceled when a cancel was asked first."""
        values = texts({"error": error, "outputs": outputs or {}, "warnings": list(warnings)})
        reached = self._run(scripts.FINISH, job_id, attempt, state, *values.values())
        return None if reached is None else JobState(reached)

    # asked by the reaper and by the parent of a worker that died

    def requeue(
        self, job_id: str, attempt: int, *, crashed: bool, why: str, only_expired: bool = False
    ) -> JobRecord | None:
        """Take a job from an attempt that ended without a result: queue it as the next attempt,
        or end it as canceled (a cancel was asked) or failed/poison (MAX_CRASHES reached).

        only_expired: only if its lease is over. None: nothing to take, otherwise the new record.
        """
        poison = json.dumps(asdict(_POISON))
        taken = self._run(
            scripts.REQUEUE,
            job_id,
            attempt,
            int(crashed),
            int(only_expired),
            MAX_CRASHES,
            why,
            poison,
        )
        return self.get(job_id) if taken else None

    def expire_waiting(self, job_id: str, longest_wait_s: float) -> bool:
        """End a job that has waited too long in the queue."""
        return bool(self._run(scripts.EXPIRE, job_id, longest_wait_s, json.dumps(asdict(_WAITED))))

    def now(self) -> float:
        """Unix seconds by the clock of Redis."""
        seconds, microseconds = self._redis.time()
        return float(seconds) + float(microseconds) / 1e6

    def queued(self) -> list[JobRecord]:
        """All waiting jobs, next first."""
        return self._fetch(self._redis.zrange(keys.QUEUED, 0, -1))

    def active(self) -> list[JobRecord]:
        """All running and canceling jobs."""
        return self._fetch(self._redis.zrange(keys.LEASES, 0, -1))

    def expired_leases(self) -> list[JobRecord]:
        """Jobs whose worker has not renewed in time."""
        ids = self._script(scripts.EXPIRED_LEASES)(keys=[keys.LEASES])
        return self._fetch(ids)

    def scans_in_use(self) -> set[str]:
        """Ids of the scans of all jobs that are known."""
        ids = self._redis.zrange(keys.INDEX, 0, -1)
        with self._redis.pipeline(transaction=False) as pipe:
            for job_id in ids:
                pipe.hget(keys.job(job_id), "scan_id")
            return {scan_id for scan_id in pipe.execute() if scan_id}

    def past_retention(self, now: float) -> list[str]:
        """Ids of finished jobs whose time is over at Unix second `now`."""
        found: list[str] = self._redis.zrangebyscore(keys.EXPIRING, "-inf", now)
        return found

    # what a Redis that forgot everything is rebuilt from

    def unsaved(self) -> list[JobRecord]:
        """Ended jobs that `mark_saved` was not called for."""
        return self._fetch(self._redis.smembers(keys.UNSAVED))

    def mark_saved(self, job_id: str) -> None:
        """The record is on disk."""
        self._redis.srem(keys.UNSAVED, job_id)

    def restore(self, values: Mapping[str, Any]) -> bool:
        """Bring an ended job back from `JobRecord.to_dict`. False: it is there already."""
        fields = texts(values)
        said = (fields[name] for name in ("state", "attempt", "error", "expires_at"))
        return bool(self._run(scripts.RESTORE, values["id"], *said, *flat(fields)))

    def is_restored(self) -> bool:
        """Whether this Redis still knows what it was told."""
        return bool(self._redis.exists(keys.RESTORED))

    def mark_restored(self) -> None:
        """Everything from the disk has been brought back."""
        self._redis.set(keys.RESTORED, "1")

    def _fetch(self, ids: Iterable[str]) -> list[JobRecord]:
        with self._redis.pipeline(transaction=False) as pipe:
            for job_id in ids:
                pipe.hgetall(keys.job(job_id))
            return [record_of(fields) for fields in pipe.execute() if "state" in fields]

    def _script(self, text: str) -> Any:
        if text not in self._scripts:
            self._scripts[text] = self._redis.register_script(text)
        return self._scripts[text]

    def _run(self, text: str, job_id: str, *values: Any, extra_key: str | None = None) -> Any:
        names = [
            keys.job(job_id),
            keys.events(job_id),
            keys.INDEX,
            keys.QUEUED,
            keys.LEASES,
            keys.EXPIRING,
            keys.UNSAVED,
        ]
        if extra_key is not None:
            names.append(extra_key)
        return self._script(text)(keys=names, args=[job_id, *values])
