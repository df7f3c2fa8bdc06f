"""Every key that udflow keeps in Redis, with its lifetime. RQ's own keys begin with `rq:`."""

EVENTS_KEPT = 2000  # about this many events a job stay readable
EVENTS_LIFE_S = 24 * 3600  # how long after the end they stay
IDEMPOTENCY_LIFE_S = 24 * 3600
TOMBSTONE_LIFE_S = 30 * 24 * 3600
PREVIEW_LIFE_S = 15 * 60  # a frame is of interest while its job runs
WATCHED_LIFE_S = 60
RECORD_MARGIN_S = 24 * 3600  # Redis drops a record this long after the sweeper should have

INDEX = "udflow:jobs:all"  # sorted set, ids in creation order; member leaves with its record
QUEUED = "udflow:jobs:queued"  # sorted set by creation time; member leaves when claimed
LEASES = "udflow:jobs:leases"  # sorted set by end of lease; member leaves at the terminal state
EXPIRING = "udflow:jobs:expiring"  # sorted set by end of retention; member leaves with its record

WEBHOOKS = "udflow:webhooks"  # sorted set, "<job id>:<state>" by when to send; leaves when settled
DELIVERIES_LIFE_S = 7 * 24 * 3600

UNFINISHED_OF = "udflow:unfinished:"  # + caller: set of ids; member leaves at the terminal state
COUNTERS = "udflow:counters"  # hash, what has happened since this Redis was new
UNSAVED = "udflow:jobs:unsaved"  # set of ended jobs; member leaves when the reaper has saved it
RESTORED = "udflow:restored"  # string; as long as this Redis remembers anything at all


def job(job_id: str) -> str:
    """Hash, the job record: from creation until its retention ends."""
    return f"udflow:job:{job_id}"


def events(job_id: str) -> str:
    """Stream of about EVENTS_KEPT: from creation until EVENTS_LIFE_S after the end."""
    return f"udflow:job:{job_id}:events"


def preview(job_id: str, kind: str) -> str:
    """String, the newest frame of this kind: PREVIEW_LIFE_S."""
    return f"udflow:job:{job_id}:preview:{kind}"


def watched(job_id: str) -> str:
    """String, says that somebody looks at frames: WATCHED_LIFE_S."""
    return f"udflow:job:{job_id}:watched"


def idempotency(key_digest: str) -> str:
    """String, digest of the body and job id: IDEMPOTENCY_LIFE_S."""
    return f"udflow:idempotency:{key_digest}"


def tombstone(some_id: str) -> str:
    """String, marks a deleted scan or job: TOMBSTONE_LIFE_S."""
    return f"udflow:gone:{some_id}"


def deliveries(job_id: str) -> str:
    """List, what became of a job's webhooks: DELIVERIES_LIFE_S after the last."""
    return f"udflow:job:{job_id}:deliveries"


def webhook_tries(job_id: str) -> str:
    """Hash, tries by state: DELIVERIES_LIFE_S after the last."""
    return f"udflow:job:{job_id}:tries"


def costs(preset: str, kind: str) -> str:
    """List, what the last finished jobs took: forever, of bounded length."""
    return f"udflow:costs:{kind}:{preset}"
