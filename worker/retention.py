"""Removing what nobody needs any more: unfinished uploads, unused scans, files of deleted jobs."""

from __future__ import annotations

import logging
import time

from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.store import FileStore
from jobs.uploads import UploadStore

log = logging.getLogger("reaper")


class Retention:
    """What the reaper does once an hour. Any number may run at once."""

    def __init__(self, settings: Settings, records: JobRecords, store: FileStore) -> None:
        self._records = records
        self._store = store
        self._uploads = UploadStore(store.root, settings.upload_life_s)
        self._scan_life_s = settings.scan_life_s

    def sweep(self) -> None:
        """Everything once. Raises redis.exceptions.RedisError when Redis does not answer."""
        for upload_id in self._uploads.expired():
            self._records.mark_gone(upload_id)
            self._uploads.delete(upload_id)
        for job_id in self._store.jobs():
            if self._records.is_gone(job_id):  # a delete was interrupted
                self._store.delete_job(job_id)
        self._remove_scans()

    def _remove_scans(self) -> None:
        """Scans older than their life that no job refers to."""
        limit = time.time() - self._scan_life_s
        used = self._records.scans_in_use()
        for scan_id in self._store.scans():
            manifest = self._store.read_scan(scan_id)
            if manifest is None:  # the service died while it took the scan in
                self._store.clear_half_scan(scan_id, limit)
                continue
            if scan_id in used or manifest["created_at"] > limit:
                continue
            log.info("%s is removed, no job has used it lately", scan_id)
            self._records.mark_gone(scan_id)
            self._store.delete_scan(scan_id)
