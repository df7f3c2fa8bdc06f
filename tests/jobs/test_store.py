import hashlib
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from jobs.errors import UnknownId
from jobs.files import create_exclusive, read_json, write_json
from jobs.ids import new_id
from jobs.spec import Artifact, JobSpec
from jobs.store import AddedScan, FileStore


def add(store: FileStore, content: bytes) -> AddedScan:
    with store.receive() as upload:
        for start in range(0, len(content), 7):
            upload.write(content[start : start + 7])
        return store.add_scan(upload, {"points": 3})


def all_files(store: FileStore) -> list[str]:
    return sorted(
        str(path.relative_to(store.root)) for path in store.root.rglob("*") if path.is_file()
    )


def test_a_scan_comes_back_whole(store: FileStore) -> None:
    content = os.urandom(1000)
    scan_id = add(store, content).id
    manifest = store.read_scan(scan_id)
    assert manifest is not None
    assert store.scan_path(scan_id).read_bytes() == content
    assert manifest["sha256"] == hashlib.sha256(content).hexdigest()
    assert (manifest["bytes"], manifest["points"], manifest["id"]) == (1000, 3, scan_id)
    assert list(store.scans()) == [scan_id]


def test_the_same_bytes_are_the_same_scan(store: FileStore) -> None:
    first = add(store, b"same")
    assert first.created
    assert add(store, b"same") == AddedScan(first.id, created=False)
    assert add(store, b"other").id != first.id


def test_the_same_bytes_at_once_are_one_scan(store: FileStore) -> None:
    with ThreadPoolExecutor(8) as pool:
        added = list(pool.map(lambda _: add(store, b"x" * 5000), range(24)))
    assert len({scan.id for scan in added}) == 1
    assert list(store.scans()) == [added[0].id]
    assert sum(scan.created for scan in added) == 1


def test_a_deleted_scan_is_gone_and_may_come_back(store: FileStore) -> None:
    first = add(store, b"bytes").id
    assert store.delete_scan(first)
    assert not store.delete_scan(first)
    assert store.read_scan(first) is None
    assert all_files(store) == []
    second = add(store, b"bytes")
    assert second.created
    assert second.id != first


def test_an_upload_that_breaks_off_leaves_nothing(store: FileStore) -> None:
    def break_off() -> None:
        with store.receive() as upload:
            upload.write(b"half of")
            raise ConnectionError

    with pytest.raises(ConnectionError):
        break_off()
    assert all_files(store) == []


def test_an_artifact_is_measured_and_named(store: FileStore) -> None:
    job_id = new_id("job")
    made = store.put_artifact(job_id, 2, "mesh.ply", lambda path: path.write_bytes(b"ply"))
    assert made == Artifact(f"jobs/{job_id}/a2/mesh.ply", 3, hashlib.sha256(b"ply").hexdigest())
    assert store.artifact_path(made).read_bytes() == b"ply"


def test_a_writer_that_fails_leaves_the_old_file_and_no_other(store: FileStore) -> None:
    job_id = new_id("job")

    def fail(path: Path) -> None:
        path.write_bytes(b"half")
        raise ValueError("no such format")

    made = store.put_artifact(job_id, 1, "report.json", lambda path: path.write_text("{}"))
    with pytest.raises(ValueError, match="no such format"):
        store.put_artifact(job_id, 1, "report.json", fail)
    assert store.artifact_path(made).read_text() == "{}"
    assert all_files(store) == [made.path]


def test_a_full_disk_leaves_no_partial_file(store: FileStore) -> None:
    """The limit on file size makes write() fail as a full disk does."""
    add(store, b"kept")
    before = all_files(store)
    program = """
import resource, signal, sys
from pathlib import Path
from jobs.ids import new_id
from jobs.store import FileStore
store = FileStore(Path(sys.argv[1]))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for attempt in (
    lambda: store.put_artifact(new_id("job"), 1, "m", lambda path: path.write_bytes(b"x" * 9999)),
    lambda: upload(),
):
    def upload():
        with store.receive() as file:
            for _ in range(99):
                file.write(b"y" * 999)
            store.add_scan(file, {})
    try:
        attempt()
    except OSError as error:
        print(error.errno)
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(store.root)], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["27", "27"]  # EFBIG
    assert all_files(store) == before


def test_no_path_leads_out(store: FileStore) -> None:
    for text in ("../../etc", "scan_../x", "job_" + "0" * 36, ""):
        with pytest.raises(UnknownId):
            store.scan_path(text)
    with pytest.raises(ValueError, match="out of the store"):
        store.artifact_path(Artifact("jobs/../../etc/passwd", 1, ""))
    assert store.find_scan("../../../etc/passwd") is None


def test_a_job_is_remembered_and_forgotten(store: FileStore) -> None:
    spec = JobSpec.new(new_id("scan"), {"seed": 1}, {"k": "v"}, ttl_s=5.0)
    store.write_job(spec)
    store.put_artifact(spec.id, 1, "a", lambda path: path.write_text(""))
    store.put_artifact(spec.id, 2, "b", lambda path: path.write_text(""))
    assert store.read_job(spec.id) == spec
    assert list(store.jobs()) == [spec.id]
    store.keep_only_attempt(spec.id, 2)
    assert all_files(store) == [f"jobs/{spec.id}/a2/b", f"jobs/{spec.id}/job.json"]
    assert store.delete_job(spec.id)
    assert not store.delete_job(spec.id)
    assert store.read_job(spec.id) is None


def test_forgotten_temporary_files_are_swept(store: FileStore) -> None:
    upload = store.receive()
    upload.write(b"the server was killed here")
    upload.close()
    assert store.sweep_temporary(older_than_s=60.0) == 0
    assert store.sweep_temporary(older_than_s=-1.0) == 1
    assert all_files(store) == []


def test_json_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    assert read_json(path) is None
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_created_only_once(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    assert create_exclusive(path, b"one", 0o600)
    assert not create_exclusive(path, b"two")
    assert path.read_bytes() == b"one"
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_manifest_of_a_later_version_is_understood(store: FileStore) -> None:
    spec = JobSpec.new(new_id("scan"), {"seed": 1})
    store.write_job(spec)
    path = store.root / "jobs" / spec.id / "job.json"
    write_json(path, read_json(path) | {"colour_of_the_future": "red"})
    assert store.read_job(spec.id) == spec
