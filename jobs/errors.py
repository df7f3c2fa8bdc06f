"""What can go wrong between asker and worker. Each message says the cause and the remedy."""

from udflow.errors import UdflowError


class BadSetting(UdflowError):
    """An environment variable holds a value that cannot be used."""

    code = "bad_setting"


class NoRedisServer(UdflowError):
    """There is no Redis to use and none that could be started."""

    code = "no_redis_server"


class UnknownId(UdflowError, KeyError):
    """The text is not an identifier made by this service, or nothing has it."""

    code = "unknown_id"

    def __str__(self) -> str:  # KeyError would print the repr
        return str(self.args[0]) if self.args else ""


class IdempotencyConflict(UdflowError):
    """The same idempotency key came with another request body."""

    code = "idempotency_conflict"


class QueueFull(UdflowError):
    """As many jobs wait as are allowed to."""

    code = "queue_full"


class TooManyJobs(UdflowError):
    """The caller has as many unfinished jobs as it may have."""

    code = "too_many_jobs"


class BadEventId(UdflowError, ValueError):
    """The position in an event stream is not one that the service gave out."""

    code = "bad_event_id"


class InvalidMac(UdflowError):
    """A queued task was not signed by this service."""

    code = "invalid_mac"
