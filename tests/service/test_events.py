"""Events: a snapshot first, then everything once and in order, over each transport."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from socket import create_connection
from typing import Any

import httpx
import pytest
import redis
from api_process import Api
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from jobs import keys
from jobs.async_records import AsyncRecords
from jobs.events import AsyncEvents, Event, Events
from jobs.ids import new_id
from jobs.records import JobRecords
from jobs.spec import JobState
from service.event_hub import MAX_PENDING, EventHub, Overflow, Watcher
from service.event_stream import EventSource, place
from service.tasks import end


@contextmanager
def watching(api: Api, job_id: str, query: str = "", **options: Any) -> Iterator[ClientConnection]:
    # a client that leaves messages unread could not close in order with the usual short queue
    url = f"{api.ws}/v1/jobs/{job_id}/events{query}"
    with connect(url, max_queue=None, **options) as socket:
        yield socket


def take(socket: ClientConnection) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(socket.recv(timeout=10))
    return message


def rest(socket: ClientConnection) -> tuple[list[dict[str, Any]], int]:
    """All messages until the server closes, and the close code."""
    messages = []
    with suppress(ConnectionClosed):
        while True:
            messages.append(take(socket))
    return messages, socket.close_code or 0


def progress(records: JobRecords, job_id: str, *shares: float) -> None:
    for share in shares:
        records.update(job_id, 1, ("progress", {"progress": share}), progress=share)


def test_a_job_from_its_snapshot_to_its_end(
    started: str, api: Api, records: JobRecords, client: httpx.Client
) -> None:
    with watching(api, started) as socket:
        snapshot = take(socket)
        assert snapshot["type"] == "snapshot"
        assert snapshot["data"] == client.get(f"/v1/jobs/{started}").json()
        records.update(started, 1, ("stage", {"stage": "fitting"}), stage="fitting")
        assert take(socket)["data"] == {"stage": "fitting"}
        records.finish(started, 1, JobState.SUCCEEDED)
        messages, code = rest(socket)
    assert [message["type"] for message in messages] == ["state", "end"]
    assert messages[-1]["data"]["state"] == "succeeded"
    assert code == 1000
    ids = [place(message["id"]) for message in [snapshot, *messages]]
    assert ids == sorted(set(ids))


def test_resuming_loses_and_repeats_nothing(
    started: str, api: Api, at_work: AbstractContextManager[None], events: Events
) -> None:
    """A client that breaks off again and again while the job goes on sees each event once."""
    seen: list[str] = []
    with at_work:
        for _ in range(12):
            with watching(api, started, f"?after={seen[-1] if seen else '0-0'}") as socket:
                assert take(socket)["type"] == "snapshot"
                seen += [take(socket)["id"] for _ in range(10)]
    with watching(api, started, f"?after={seen[-1]}") as socket:
        assert take(socket)["type"] == "snapshot"
        messages, code = rest(socket)
    seen += [message["id"] for message in messages]
    assert (messages[-1]["type"], code) == ("end", 1000)
    assert seen == [event.id for event in events.read(started, count=10_000)]


def test_a_finished_job_ends_at_once(started: str, api: Api, records: JobRecords) -> None:
    records.finish(started, 1, JobState.SUCCEEDED)
    with watching(api, started) as socket:
        messages, code = rest(socket)
    assert [message["type"] for message in messages] == ["snapshot", "end"]
    assert messages[1]["data"]["state"] == "succeeded"
    assert code == 1000
    with watching(api, started, f"?after={messages[1]['id']}") as socket:
        messages, code = rest(socket)
    assert ([message["type"] for message in messages], code) == (["snapshot"], 1000)


def test_a_finished_job_can_be_replayed(
    started: str, api: Api, records: JobRecords, events: Events
) -> None:
    progress(records, started, 0.2, 0.4)
    records.finish(started, 1, JobState.SUCCEEDED)
    with watching(api, started, "?after=0-0") as socket:
        messages, _ = rest(socket)
    expected = ["snapshot", "state", "state", "progress", "progress", "state", "end"]
    assert [message["type"] for message in messages] == expected


def test_what_is_no_longer_kept_is_said(
    started: str, api: Api, records: JobRecords, redis_client: redis.Redis, events: Events
) -> None:
    first = events.read(started)[0].id
    progress(records, started, 0.1, 0.2, 0.3)
    redis_client.xtrim(keys.events(started), maxlen=1, approximate=False)
    for after in (first, "0-0", "99999999999999-0"):
        with watching(api, started, f"?after={after}") as socket:
            gap, snapshot = take(socket), take(socket)
            assert (gap["type"], gap["data"]["after"]) == ("gap", after)
            assert (snapshot["type"], snapshot["data"]["progress"]) == ("snapshot", 0.3)
            progress(records, started, 0.3)
            assert place(take(socket)["id"]) > place(snapshot["id"])


def test_many_watch_one_job(started: str, api: Api, records: JobRecords) -> None:
    with watching(api, started) as one, watching(api, started) as two:
        assert take(one)["data"] == take(two)["data"]
        progress(records, started, 0.5)
        assert take(one) == take(two)
        records.finish(started, 1, JobState.SUCCEEDED)
        assert rest(one) == rest(two)


@pytest.mark.parametrize("job_id", ["nope", new_id("job")], ids=["nope", "new"])
def test_unknown_jobs_close_with_4404(job_id: str, api: Api) -> None:
    with watching(api, job_id) as socket:
        assert rest(socket) == ([], 4404)


def test_a_malformed_place_closes_with_4400(queued: str, api: Api, client: httpx.Client) -> None:
    with watching(api, queued, "?after=yesterday") as socket:
        assert rest(socket) == ([], 4400)
    answer = client.get(f"/v1/jobs/{queued}/events?after=yesterday")
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "?after")


def test_what_clients_say_is_ignored(started: str, api: Api, records: JobRecords) -> None:
    with watching(api, started) as socket:
        take(socket)
        socket.send('{"type": "ack"}')
        socket.send(b"\x00\xff")
        progress(records, started, 0.5)
        assert take(socket)["type"] == "progress"


@pytest.mark.parametrize(
    ("origin", "host", "status"),
    [
        (None, None, 101),
        ("own", None, 101),
        ("http://evil.example", None, 403),
        ("null", None, 403),
        ("http://127.0.0.1:1", None, 403),
        (None, "evil.example", 421),
        ("http://evil.example", "evil.example", 421),
        (None, "localhost.evil.example:80", 421),
    ],
)
def test_pages_of_other_sites_get_no_websocket(
    origin: str | None, host: str | None, status: int, queued: str, api: Api
) -> None:
    server = httpx.URL(api.url)
    sent = api.url if origin == "own" else origin
    url = f"ws://{host or server.netloc.decode()}/v1/jobs/{queued}/events"
    found = 101
    with create_connection((server.host, server.port)) as raw:
        try:
            with connect(url, sock=raw, origin=sent):
                pass
        except InvalidStatus as refused:
            found = refused.response.status_code
    assert found == status


def test_a_page_of_events(started: str, client: httpx.Client, records: JobRecords) -> None:
    progress(records, started, 0.2, 0.4)
    url = f"/v1/jobs/{started}/events"
    page = client.get(url).json()
    types = ["state", "state", "progress", "progress"]
    assert [event["type"] for event in page["events"]] == types
    assert (page["last_id"], page["end"]) == (page["events"][-1]["id"], False)
    two = client.get(url, params={"limit": 2}).json()
    assert two["events"] == page["events"][:2]
    assert client.get(url, params={"after": two["last_id"]}).json()["events"] == page["events"][2:]
    records.finish(started, 1, JobState.SUCCEEDED)
    last = client.get(url, params={"after": page["last_id"]}).json()
    assert [event["type"] for event in last["events"]] == ["state", "end"]
    assert last["end"] is True
    empty = client.get(url, params={"after": last["last_id"]}).json()
    assert empty == {"events": [], "last_id": last["last_id"], "end": True}


def frames(text: str) -> list[dict[str, str]]:
    blocks = [block for block in text.split("\n\n") if block and not block.startswith(":")]
    return [dict(line.split(": ", 1) for line in block.split("\n")) for block in blocks]


def test_server_sent_events(started: str, client: httpx.Client, records: JobRecords) -> None:
    progress(records, started, 0.2)
    records.finish(started, 1, JobState.SUCCEEDED)
    url, accept = f"/v1/jobs/{started}/events", {"accept": "text/event-stream"}
    every = client.get(url, params={"after": "0-0"}, headers=accept)
    assert every.headers["content-type"].startswith("text/event-stream")
    sent = frames(every.text)
    types = [frame["event"] for frame in sent]
    assert types == ["snapshot", "state", "state", "progress", "state", "end"]
    assert all(json.loads(frame["data"])["id"] == frame["id"] for frame in sent)
    resumed = client.get(url, headers=accept | {"last-event-id": sent[3]["id"]})
    assert frames(resumed.text)[1:] == sent[4:]


def event(number: int, kind: str) -> Event:
    return Event(f"{number}-0", kind, 0.0, {})


def test_waiting_progress_is_replaced_and_states_are_kept() -> None:
    async def story() -> list[str]:
        watcher = Watcher("0-0")
        for number in range(3000):
            watcher.offer(event(number, "state" if number % 100 == 0 else "progress"))
        taken = []
        while (found := await watcher.next(0.01)) is not None:
            taken.append(found.id)
        return taken

    ids = asyncio.run(story())
    assert {f"{number}-0" for number in range(0, 3000, 100)} <= set(ids)
    assert len(ids) == 60
    assert ids[-1] == "2999-0"


def test_who_never_reads_is_cut_off_not_skipped() -> None:
    async def story() -> None:
        watcher = Watcher("0-0")
        for number in range(MAX_PENDING + 1):
            watcher.offer(event(number, "state"))
        await watcher.next(0.01)

    with pytest.raises(Overflow):
        asyncio.run(story())


def test_silence_is_broken_by_heartbeats_until_the_job_is_deleted(
    started: str, api: Api, records: JobRecords
) -> None:
    async def story() -> list[str]:
        connection = api.shared.connect_async()
        events = AsyncEvents(connection)
        hub = EventHub(events)
        reader = asyncio.create_task(hub.run())
        types = []
        try:
            source = EventSource(AsyncRecords(connection), events, hub, 0.05)
            async for message in source.stream(started, None):
                types.append(message.type)
                if len(types) == 4:
                    records.delete(started, force=True)
        except Exception as error:
            types.append(type(error).__name__)
        assert hub.watcher_count() == 0
        await end(reader)
        await connection.aclose()
        return types

    assert asyncio.run(story()) == ["snapshot"] + ["heartbeat"] * 3 + ["UnknownJob"]


def test_the_reader_of_events_ends_whenever_it_is_told_to(api: Api) -> None:
    """Also in the moments in which a cancel gets lost: the API could not be shut down."""

    async def story(steps: int) -> bool:
        connection = api.shared.connect_async()
        hub = EventHub(AsyncEvents(connection))
        await connection.ping()  # what follows begins with a connection that stands
        reader = asyncio.create_task(hub.run())
        with hub.watch(new_id("job"), "0-0"):
            for _ in range(steps):
                await asyncio.sleep(0)
        _, unfinished = await asyncio.wait([asyncio.create_task(end(reader))], timeout=5)
        await connection.aclose()
        return not unfinished

    assert all(asyncio.run(story(steps)) for steps in range(12))


def test_two_hundred_come_at_once_and_none_is_turned_away(
    started: str, api: Api, records: JobRecords
) -> None:
    url = f"{api.ws}/v1/jobs/{started}/events"

    async def watch(arrived: asyncio.Semaphore) -> list[str]:
        async with connect_async(url, open_timeout=60) as line:
            types = [json.loads(await line.recv())["type"]]
            arrived.release()
            return types + [json.loads(message)["type"] async for message in line]

    async def story() -> list[list[str]]:
        arrived = asyncio.Semaphore(0)
        tasks = [asyncio.create_task(watch(arrived)) for _ in range(200)]
        for _ in tasks:
            await asyncio.wait_for(arrived.acquire(), 60)
        records.finish(started, 1, JobState.SUCCEEDED)
        return await asyncio.gather(*tasks)

    assert asyncio.run(story()) == [["snapshot", "state", "end"]] * 200
