"""Who may give the worker work: tasks carry an HMAC over {job, attempt}."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import sys
from pathlib import Path

from jobs.errors import InvalidMac
from jobs.files import create_exclusive
from jobs.settings import Settings


def load_secret(settings: Settings) -> bytes:
    """The signing key: UDFLOW_SECRET, else one beside the scans and results (in the bucket, or as
    a file in the data folder), made on first use."""
    if settings.secret is not None:
        return settings.secret.encode()
    if (settings.store_url or "").startswith("s3://"):
        from jobs.object_store import shared_secret

        return shared_secret(settings.store_url or "", secrets.token_hex(32))
    path: Path = settings.data / "secret.key"
    settings.data.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        create_exclusive(path, secrets.token_hex(32).encode(), mode=0o600)
    return path.read_bytes()


def sign(secret: bytes, job_id: str, attempt: int) -> str:
    """HMAC-SHA256, hexadecimal."""
    return hmac.new(secret, f"udflow-task:{job_id}:{attempt}".encode(), hashlib.sha256).hexdigest()


def verify(secret: bytes, job_id: str, attempt: int, mac: str) -> None:
    """Raises InvalidMac unless `mac` was made by `sign` with the same secret."""
    expected = sign(secret, job_id, attempt)
    if not hmac.compare_digest(expected.encode(), mac.encode()):
        raise InvalidMac(
            f"the queued task for {job_id}, attempt {attempt}, was not signed with this worker's "
            "secret; give service and worker the same UDFLOW_SECRET or the same data folder"
        )


if __name__ == "__main__":  # for processes that must not touch the store themselves
    sys.stdout.buffer.write(load_secret(Settings.from_env()))
