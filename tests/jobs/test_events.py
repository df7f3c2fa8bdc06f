import asyncio
import threading
import time

import pytest
import redis

from jobs import keys
from jobs.errors import BadEventId
from jobs.events import START, AsyncEvents, Event, Events
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.spec import JobSpec, JobState


def a_running_job(records: JobRecords) -> str:
    job_id = records.create(JobSpec.new(new_id("scan"), {})).record.id
    records.claim(job_id, 1)
    return job_id


def test_reading_again_from_any_point_repeats_nothing(records: JobRecords, events: Events) -> None:
    job_id = a_running_job(records)
    for step in range(10):
        records.update(job_id, 1, ("progress", {"step": step, "loss": None}))
    told = events.read(job_id)
    assert [event.type for event in told] == ["state", "state"] + ["progress"] * 10
    for place, event in enumerate(told):
        assert events.read(job_id, event.id) == told[place + 1 :]
    assert told[-1].data == {"step": 9, "loss": None}
    assert abs(told[-1].time - time.time()) < 5.0


def test_a_snapshot_and_the_events_after_it_are_the_whole_story(
    records: JobRecords, events: Events
) -> None:
    job_id = a_running_job(records)
    records.update(job_id, 1, ("progress", {"progress": 0.5}), progress=0.5)
    snapshot = records.snapshot(job_id)
    assert snapshot is not None
    assert snapshot.record.progress == 0.5
    assert events.read(job_id, snapshot.last_event) == []
    records.finish(job_id, 1, JobState.SUCCEEDED)
    assert [event.type for event in events.read(job_id, snapshot.last_event)] == ["state", "end"]


def test_a_waiting_reader_wakes(events: Events, settings: Settings) -> None:
    job_id = new_id("job")
    connection = settings.connect()
    timer = threading.Timer(0.2, lambda: Events(connection).publish(job_id, "warning", {"a": 1}))
    timer.start()
    began = time.monotonic()
    told = events.read(job_id, block_ms=4000)
    assert 0.1 < time.monotonic() - began < 2.0
    assert [(event.type, event.data) for event in told] == [("warning", {"a": 1})]
    timer.join()
    connection.close()


def test_waiting_in_vain_ends_in_time(events: Events) -> None:
    began = time.monotonic()
    assert events.read(new_id("job"), block_ms=200) == []
    assert 0.15 < time.monotonic() - began < 2.0


def test_the_longest_wait_is_shorter_than_the_socket_timeout(events: Events) -> None:
    began = time.monotonic()
    assert events.read(new_id("job"), block_ms=60_000) == []  # would raise TimeoutError after 5 s
    assert time.monotonic() - began < 4.9


def test_a_stream_is_bounded_and_ends_after_the_job(
    records: JobRecords, events: Events, connection: redis.Redis
) -> None:
    job_id = a_running_job(records)
    assert connection.ttl(keys.events(job_id)) == -1
    for step in range(keys.EVENTS_KEPT + 500):
        records.update(job_id, 1, ("progress", {"step": step}))
    assert connection.xlen(keys.events(job_id)) < keys.EVENTS_KEPT + 200
    records.finish(job_id, 1, JobState.FAILED)
    assert 0 < connection.ttl(keys.events(job_id)) <= keys.EVENTS_LIFE_S
    assert events.read(job_id, count=5000)[-1].type == "end"


@pytest.mark.parametrize("text", ["", "x", "-", "$", "1-2-3", "9" * 30, "1 2", "0-0\n"])
def test_a_position_that_is_none_is_refused_in_words(events: Events, text: str) -> None:
    with pytest.raises(BadEventId, match="an event id looks like"):
        events.read(new_id("job"), text)


def test_the_largest_position_is_legal(events: Events) -> None:
    assert events.read(new_id("job"), "9" * 19 + "-" + "9" * 19) == []


def test_the_async_reader_sees_the_same(
    records: JobRecords, events: Events, settings: Settings
) -> None:
    first, second = a_running_job(records), a_running_job(records)
    told = events.read(first)

    async def read() -> tuple[list[Event], dict[str, list[Event]], list[bool]]:
        connection = settings.connect_async()
        reader = AsyncEvents(connection)
        one = await reader.read(first, told[0].id)
        both = await reader.read_many({first: START, second: told[-1].id, new_id("job"): START})
        gaps = [await reader.has_gap(first, after) for after in (START, told[0].id, "5-0")]
        gaps.append(await reader.has_gap(new_id("job"), told[0].id))
        await connection.aclose()
        return one, both, gaps

    one, both, gaps = asyncio.run(read())
    assert one == told[1:]
    assert both[first] == told
    assert gaps == [False, False, True, True]


def test_the_async_reader_waits_and_wakes(settings: Settings, events: Events) -> None:
    job_id = new_id("job")

    async def wait() -> list[Event]:
        connection = settings.connect_async()
        waiting = asyncio.create_task(AsyncEvents(connection).read(job_id, block_ms=4000))
        await asyncio.sleep(0.2)
        await asyncio.to_thread(events.publish, job_id, "warning", {})
        told = await waiting
        await connection.aclose()
        return told

    assert [event.type for event in asyncio.run(wait())] == ["warning"]
