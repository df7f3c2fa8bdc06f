"""What nobody needs any more is removed, and nothing else."""

from __future__ import annotations

import os
import time
from dataclasses import replace

from shapes import Sphere
from workshop import Workshop

from jobs.ids import new_id
from jobs.uploads import UploadStore
from worker.retention import Retention


def retention(shop: Workshop) -> Retention:
    settings = replace(shop.settings, upload_life_s=100.0, scan_life_s=0.001)
    return Retention(settings, shop.records, shop.store)


def test_unfinished_uploads_expire(own_shop: Workshop) -> None:
    uploads = UploadStore(own_shop.store.root, 100.0)
    fresh, stale = (uploads.create(10, "a.ply", "", None) for _ in range(2))
    long_ago = time.time() - 101
    os.utime(uploads.data(stale.id), (long_ago, long_ago))
    retention(own_shop).sweep()
    assert uploads.read(stale.id) is None
    assert own_shop.records.is_gone(stale.id)
    assert uploads.read(fresh.id) == fresh


def test_scans_without_jobs_expire(own_shop: Workshop) -> None:
    unused, used = (own_shop.scan(Sphere().sample(200).numpy()) for _ in range(2))
    own_shop.submit(scan_id=used)
    time.sleep(0.01)
    retention(own_shop).sweep()
    assert own_shop.store.read_scan(unused) is None
    assert own_shop.records.is_gone(unused)
    assert own_shop.store.read_scan(used) is not None


def test_files_of_deleted_jobs_do_not_stay(own_shop: Workshop) -> None:
    kept, deleted = own_shop.submit(), own_shop.submit()
    own_shop.records.delete(deleted, force=True)  # and then the process died
    retention(own_shop).sweep()
    assert set(own_shop.store.jobs()) == {kept}
    assert not own_shop.records.is_gone(new_id("job"))


def test_bytes_that_never_became_a_scan_go(own_shop: Workshop) -> None:
    half = own_shop.store.root / "scans" / new_id("scan")
    half.mkdir()
    (half / "data").write_bytes(b"the service died here")
    Retention(own_shop.settings, own_shop.records, own_shop.store).sweep()
    assert half.exists()  # it may be on its way
    time.sleep(0.01)
    retention(own_shop).sweep()
    assert not half.exists()
