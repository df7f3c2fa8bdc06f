import os
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis

from jobs import redis_server
from jobs.errors import NoRedisServer
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.redis_server import EmbeddedRedis, find_server, make_private_folder
from jobs.settings import Settings
from jobs.spec import JobSpec


@pytest.fixture
def server(tmp_path: Path) -> Iterator[EmbeddedRedis]:
    found = EmbeddedRedis(tmp_path / ("deep" * 40) / "data")
    yield found
    found.stop()


def socket_of(server: EmbeddedRedis) -> Path:
    return Path(server.url.removeprefix("unix://"))


def test_it_starts_in_private_and_leaves_nothing(server: EmbeddedRedis) -> None:
    server.start()
    path = socket_of(server)
    assert len(os.fsencode(path)) <= 100
    assert path.parent.stat().st_mode & 0o777 == 0o700
    with redis.Redis.from_url(server.url, decode_responses=True) as client:
        assert client.config_get("appendonly") == {"appendonly": "yes"}
        assert client.config_get("port") == {"port": "0"}
        pid = client.info("server")["process_id"]
    server.stop()
    assert not path.parent.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_killing_it_loses_no_acknowledged_job(server: EmbeddedRedis) -> None:
    accepted: list[str] = []
    for _ in range(3):
        server.start()
        settings = Settings(redis_url=server.url)
        with settings.connect() as client:
            records = JobRecords(client)
            assert [r.id for r in records.queued()] == accepted
            for _ in range(50):
                accepted.append(records.create(JobSpec.new(new_id("scan"), {})).record.id)
            os.kill(client.info("server")["process_id"], signal.SIGKILL)
        server.stop()


def test_it_dies_with_its_parent(tmp_path: Path) -> None:
    program = """
import sys, time
from pathlib import Path
from jobs.redis_server import EmbeddedRedis
server = EmbeddedRedis(Path(sys.argv[1]))
server.start()
print("up", flush=True)
time.sleep(60)
"""
    parent = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    assert parent.stdout.readline() == "up\n"
    server = EmbeddedRedis(tmp_path)
    assert server.answers()
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 5.0
    while server.answers() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not server.answers()
    server.remove_socket()


def test_a_broken_append_only_file_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "redis").mkdir()
    (tmp_path / "redis" / "appendonly.aof").write_bytes(b"this is not Redis's format\r\n" * 20)
    (tmp_path / "redis" / "appendonlydir").mkdir()  # where newer servers look
    (tmp_path / "redis" / "appendonlydir" / "appendonly.aof.manifest").write_text("nonsense\n")
    server = EmbeddedRedis(tmp_path)
    with pytest.raises(NoRedisServer, match="append-only file may be damaged"):
        server.start()
    assert not socket_of(server).parent.exists()


def test_no_server_is_said_with_three_remedies(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_server().name in ("redis-server", "valkey-server")
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.setattr(redis_server, "_WHEELS", ("no_such_package",))
    monkeypatch.setattr(sysconfig, "get_path", lambda _: "/nonexistent")
    with pytest.raises(NoRedisServer, match=r"apt install.*pip install.*REDIS_URL"):
        find_server()


def test_a_server_on_the_path_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "valkey-server"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_server() == program


def test_a_folder_that_others_can_enter_is_refused(tmp_path: Path) -> None:
    open_to_all = tmp_path / "a"
    open_to_all.mkdir(mode=0o755)
    link = tmp_path / "b"
    (tmp_path / "target").mkdir(mode=0o700)
    link.symlink_to(tmp_path / "target")
    for folder in (open_to_all, link):
        with pytest.raises(NoRedisServer, match="not a private folder"):
            make_private_folder(folder)
