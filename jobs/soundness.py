"""Noticing stored files whose bytes are not those that were written."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from pathlib import Path

from jobs.files import measure
from jobs.spec import Artifact

_TRUSTED_S = 60.0  # how long a file that was found sound is not read again
_MOST = 1000


class Soundness:
    """Compares files with the sizes and digests in their job's record."""

    def __init__(self, trusted_s: float = _TRUSTED_S) -> None:
        self._trusted_s = trusted_s
        self._sound: OrderedDict[tuple[str, int, int, str], float] = OrderedDict()
        self._lock = threading.Lock()

    def is_sound(self, path: Path, artifact: Artifact) -> bool:
        """Whether the file has the artifact's bytes. Reads all of it, unless it did so lately.

        Raises:
            OSError: the file cannot be read.
        """
        status = path.stat()
        if status.st_size != artifact.bytes:
            return False
        key = (str(path), status.st_ino, status.st_mtime_ns, artifact.sha256)
        now = time.monotonic()
        with self._lock:
            if self._sound.get(key, 0.0) > now:
                return True
        if measure(path) != (artifact.bytes, artifact.sha256):
            return False
        with self._lock:
            self._sound[key] = now + self._trusted_s
            while len(self._sound) > _MOST:
                self._sound.popitem(last=False)
        return True
