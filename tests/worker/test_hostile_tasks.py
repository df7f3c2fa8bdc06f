"""Whoever can write to the queue cannot make a worker run other code."""

import json
import pickle
from pathlib import Path
from typing import Any

import pytest
import rq
from rq.job import Callback
from rq.serializers import JSONSerializer
from workshop import Workshop

from jobs.dispatch import QUEUE, TASK
from jobs.ids import new_id
from jobs.signing import sign
from jobs.spec import JobSpec, JobState


class Bomb:
    """Runs a command where it is unpickled."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __reduce__(self) -> tuple[Any, ...]:
        import os

        return os.system, (self.command,)


def push(shop: Workshop, function: str, *arguments: Any, **options: Any) -> str:
    """The id of a task put into RQ's queue past the service."""
    queue = rq.Queue(QUEUE, connection=shop.raw, serializer=JSONSerializer)
    return str(queue.enqueue_call(function, args=arguments, failure_ttl=600, **options).id)


def the_worker_has_refused(shop: Workshop, task: str) -> None:
    key = f"rq:job:{task}"
    shop.until(lambda: shop.raw.hget(key, "status") == b"failed", 20.0)


def test_a_shell_command_does_not_run(shop: Workshop, tmp_path: Path) -> None:
    marker = tmp_path / "owned"
    the_worker_has_refused(shop, push(shop, "os.system", f"touch {marker}"))
    assert not marker.exists()
    assert "only worker.tasks.run may be run" in shop.log()


def test_a_pickle_does_not_run(shop: Workshop, tmp_path: Path) -> None:
    marker = tmp_path / "owned"
    task = push(shop, TASK)
    shop.raw.hset(f"rq:job:{task}", "data", pickle.dumps(Bomb(f"touch {marker}")))
    shop.raw.hset(f"rq:job:{task}", "meta", pickle.dumps(Bomb(f"touch {marker}")))
    the_worker_has_refused(shop, task)
    assert not marker.exists()


@pytest.mark.parametrize("way", ["on_failure", "on_success", "on_stopped"])
def test_a_callback_does_not_run(shop: Workshop, tmp_path: Path, way: str) -> None:
    marker = tmp_path / "owned"
    module = tmp_path / "hostile.py"
    module.write_text(f"open({str(marker)!r}, 'w')\ndef f(*args): pass\n")
    task = push(shop, TASK, new_id("job"), 1, "00", **{way: Callback("hostile.f")})
    the_worker_has_refused(shop, task)
    assert "hostile" not in shop.log()
    assert not marker.exists()


def test_an_instance_or_another_name_does_not_run(shop: Workshop) -> None:
    for data in ([TASK, {"a": 1}, [], {}], ["worker.tasks.train", None, [], {}], [None] * 4, 7):
        task = push(shop, TASK)
        shop.raw.hset(f"rq:job:{task}", "data", json.dumps(data))
        the_worker_has_refused(shop, task)


def test_malformed_and_unsigned_tasks_do_not_touch_the_job(own_shop: Workshop) -> None:
    for field, value in (("timeout", "soon"), ("status", "?")):
        own_shop.raw.hset(f"rq:job:{push(own_shop, TASK)}", field, value)
    spec = JobSpec.new(new_id("scan"), {})
    own_shop.records.create(spec)
    worker = own_shop.start_worker()
    for mac in ("", "0" * 64, sign(b"another key", spec.id, 1)):
        the_worker_has_refused(own_shop, push(own_shop, TASK, spec.id, 1, mac))
    assert own_shop.states(spec.id) == ["queued"]
    own_shop.dispatcher.enqueue(spec.id, 1)
    own_shop.reaches(spec.id, JobState.FAILED)  # its scan does not exist
    assert own_shop.log().count("malformed task ") == 2
    assert worker.poll() is None


def test_arguments_of_any_kind_are_refused(shop: Workshop) -> None:
    for arguments in ([], [1, 2, 3], ["../x", 1, "00"], [{"a": 1}, [], None], ["a"] * 9):
        the_worker_has_refused(shop, push(shop, TASK, *arguments))
