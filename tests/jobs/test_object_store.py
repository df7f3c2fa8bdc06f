"""Scans and results in a bucket: two machines that share nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from s3_server import S3Server

from jobs.errors import BadSetting
from jobs.ids import new_id
from jobs.object_store import ObjectStore
from jobs.open_store import open_store
from jobs.settings import Settings
from jobs.signing import load_secret
from jobs.spec import JobSpec
from jobs.store import FileStore

URL = "s3://bucket/udflow"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with S3Server(tmp_path_factory.mktemp("s3")) as running:
        yield running


@pytest.fixture
def here(server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ObjectStore:
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return ObjectStore(URL, tmp_path / "here")


@pytest.fixture
def there(here: ObjectStore, tmp_path: Path) -> ObjectStore:
    """The same bucket from another machine."""
    return ObjectStore(URL, tmp_path / "there")


def add(store: ObjectStore, data: bytes, caller: str | None = None) -> str:
    with store.receive() as upload:
        upload.write(data)
        return store.add_scan(upload, {"points": 3, "caller": caller}).id


def test_a_scan_is_there_for_all(here: ObjectStore, there: ObjectStore) -> None:
    scan_id = add(here, b"some points")
    manifest = there.read_scan(scan_id)
    assert manifest is not None
    assert (manifest["bytes"], manifest["points"]) == (11, 3)
    assert there.scan_path(scan_id).read_bytes() == b"some points"
    assert add(there, b"some points") == scan_id
    assert add(there, b"some points", caller="anna") != scan_id
    assert scan_id in list(there.scans())
    assert there.delete_scan(scan_id)
    assert not here.delete_scan(scan_id)
    assert here.read_scan(scan_id) is None
    assert add(here, b"some points") != scan_id


def test_another_machine_goes_on_from_a_checkpoint(here: ObjectStore, there: ObjectStore) -> None:
    job_id = new_id("job")
    for attempt in (1, 2):
        here.checkpoint_path(job_id, attempt).write_bytes(b"state %d" % attempt)
        here.share_checkpoint(job_id, attempt)
        here.note_attempt(job_id, attempt)
    assert there.last_attempt(job_id) == 2
    assert there.checkpoints(job_id, before=3) == [2, 1]
    assert there.checkpoint_path(job_id, 2).read_bytes() == b"state 2"
    for store in (there, here):
        store.clear_checkpoints(job_id)
        assert store.checkpoints(job_id, before=3) == []
    assert not (here.root / "jobs" / job_id).exists()
    assert there.last_attempt(job_id) == 2


def test_results_are_there_for_all(here: ObjectStore, there: ObjectStore) -> None:
    spec = JobSpec.new(new_id("scan"), {"seed": 1})
    here.write_job(spec)
    assert there.read_job(spec.id) == spec
    first, second = (
        here.put_artifact(spec.id, attempt, "mesh.ply", lambda path: path.write_bytes(b"mesh"))
        for attempt in (1, 2)
    )
    assert there.artifact_path(second).read_bytes() == b"mesh"
    link = there.link_to(second)
    assert link is not None
    answer = httpx.get(link)
    assert answer.content == b"mesh"
    assert answer.headers["content-disposition"] == 'attachment; filename="mesh.ply"'
    assert answer.headers["content-type"] == "application/x-ply"
    assert httpx.get(link.partition("?")[0]).status_code in (400, 403)
    here.keep_only_attempt(spec.id, 2)
    assert not there.artifact_path(first).exists()
    assert spec.id in list(there.jobs())
    assert there.delete_job(spec.id)
    assert here.read_job(spec.id) is None
    assert not there.delete_job(spec.id)


def test_a_large_file_arrives_whole(here: ObjectStore, there: ObjectStore) -> None:
    data = bytes(range(256)) * 60_000
    assert there.scan_path(add(here, data)).read_bytes() == data


def test_the_signing_key_is_shared(here: ObjectStore, tmp_path: Path) -> None:
    keys = {
        load_secret(Settings(data=tmp_path / name, store_url="s3://bucket/other"))
        for name in ("a", "b", "c")
    }
    assert len(keys) == 1
    assert len(keys.pop()) == 64


def test_copies_can_be_removed(here: ObjectStore) -> None:
    scan_id = add(here, b"other points")
    assert here.sweep_temporary(-1.0) >= 1
    assert here.scan_path(scan_id).read_bytes() == b"other points"


def test_what_a_store_address_may_be(tmp_path: Path) -> None:
    assert type(open_store(Settings(data=tmp_path))) is FileStore
    folder = tmp_path / "a b"
    named = open_store(Settings(data=tmp_path, store_url=folder.as_uri()))
    assert named.root == folder
    for wrong in ("ftp://x/y", "s3://", "file:", "plain/path"):
        with pytest.raises(BadSetting, match="STORE_URL"):
            open_store(Settings(data=tmp_path, store_url=wrong))
