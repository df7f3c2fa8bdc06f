"""Every error that udflow raises on purpose. Each message says the cause and the remedy."""


class UdflowError(Exception):
    """Base of all errors raised on purpose by udflow.

    `code` is stable and made for programs; the message is made for people.
    """

    code = "udflow_error"


class InvalidCloud(UdflowError, ValueError):
    """The point cloud cannot be read or cannot be reconstructed."""

    code = "invalid_cloud"


class UnknownFormat(InvalidCloud):
    """The bytes are of no format that udflow reads."""

    code = "unknown_format"


class InvalidConfig(UdflowError, ValueError):
    """A parameter lies outside its range, or parameters contradict each other."""

    code = "invalid_config"


class InvalidQuery(UdflowError, ValueError):
    """Query points are not a finite (n, 3) array."""

    code = "invalid_query"


class UnknownSample(UdflowError, LookupError):
    """There is no simulated scan of this name."""

    code = "sample_not_found"


class Diverged(UdflowError, ArithmeticError):
    """A fit produced values that are not finite, or a network that says 0 everywhere."""

    code = "diverged"


class EmptySurface(UdflowError):
    """The field has no surface inside the box at this resolution."""

    code = "empty_surface"


class BadField(UdflowError, ValueError):
    """A stored field is damaged or incomplete."""

    code = "bad_field"


class OutdatedField(BadField):
    """A stored field is of a version that this release does not read."""

    code = "outdated_field"


class Canceled(UdflowError):
    """The caller asked to stop."""

    code = "canceled"


class BadCheckpoint(BadField):
    """A checkpoint is damaged or belongs to another cloud or configuration."""

    code = "bad_checkpoint"
