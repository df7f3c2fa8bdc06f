"""Frames over the websocket: the newest at once, each new one behind its event, none unasked."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from api_process import Api
from websockets.sync.client import ClientConnection, connect

from jobs.events import Event
from jobs.previews import Previews, sequence_of
from jobs.records import JobRecords
from jobs.spec import JobState
from service.event_hub import Watcher

Announce = Callable[[int], None]


def frame(sequence: int) -> bytes:
    """As much of a frame as the service looks at."""
    return b"UDFP\x01\x01\x00\x00" + np.uint32(sequence).tobytes() + bytes(52)


@pytest.fixture
def announce(api: Api, records: JobRecords, started: str) -> Announce:
    """Plays the worker: a frame, then its event."""

    def act(sequence: int) -> None:
        with api.shared.connect() as connection:
            Previews(connection).put(started, "points", frame(sequence))
        records.update(started, 1, ("preview", {"kind": "points", "sequence": sequence}))

    return act


def watch(api: Api, job_id: str, query: str = "?previews=binary") -> ClientConnection:
    return connect(f"{api.ws}/v1/jobs/{job_id}/events{query}")


def next_frame(socket: ClientConnection) -> int:
    while not isinstance(message := socket.recv(timeout=5), bytes):
        pass
    return sequence_of(message)


def test_a_newcomer_gets_the_newest_frame_and_then_each_new_one(
    api: Api, started: str, announce: Announce
) -> None:
    announce(1)
    announce(2)
    with watch(api, started) as socket:
        assert json.loads(socket.recv(timeout=5))["type"] == "snapshot"
        assert next_frame(socket) == 2
        announce(3)
        assert json.loads(socket.recv(timeout=5))["data"]["sequence"] == 3
        assert next_frame(socket) == 3


def test_replayed_announcements_bring_no_frame_twice(
    api: Api, started: str, announce: Announce
) -> None:
    for sequence in (1, 2, 3):
        announce(sequence)
    with watch(api, started, "?previews=binary&after=0-0") as socket:
        assert next_frame(socket) == 3
        announce(4)
        assert next_frame(socket) == 4


def test_two_clients_get_the_same_frame(api: Api, started: str, announce: Announce) -> None:
    with watch(api, started) as first, watch(api, started) as second:
        announce(5)
        assert next_frame(first) == next_frame(second) == 5


def test_only_those_who_ask_get_frames(
    api: Api, started: str, announce: Announce, records: JobRecords
) -> None:
    with watch(api, started, "") as socket:
        announce(1)
        records.finish(started, 1, JobState.CANCELED)
        messages = list(socket)
    assert all(isinstance(message, str) for message in messages)
    assert any(json.loads(message)["type"] == "preview" for message in messages)


def test_a_watcher_makes_the_job_watched(api: Api, started: str) -> None:
    with api.shared.connect() as connection:
        previews = Previews(connection)
        assert not previews.is_watched(started)
        with watch(api, started) as socket:
            socket.recv(timeout=5)
            deadline = time.monotonic() + 5
            while not previews.is_watched(started):
                assert time.monotonic() < deadline


async def drained(watcher: Watcher) -> list[tuple[str, Any]]:
    found = []
    while (event := await watcher.next(0.01)) is not None:
        found.append((event.type, event.data.get("sequence")))
    return found


def test_a_slow_reader_skips_previews_and_no_state() -> None:
    watcher = Watcher("0-0")
    for number in range(1, 1000):
        kind = "mesh" if number % 2 else "points"
        watcher.offer(Event(f"{number}-0", "preview", 0.0, {"kind": kind, "sequence": number}))
        if number % 300 == 0:
            watcher.offer(Event(f"{number}-1", "state", 0.0, {}))
    assert asyncio.run(drained(watcher)) == [
        *[("state", None)] * 3,
        ("preview", 998),
        ("preview", 999),
    ]
