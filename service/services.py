"""The parts that the routes work with, made once per process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated

import redis
from fastapi import Depends
from starlette.requests import HTTPConnection

from jobs.async_records import AsyncRecords
from jobs.dispatch import Dispatcher
from jobs.events import AsyncEvents
from jobs.open_store import open_store
from jobs.previews import AsyncPreviews
from jobs.records import JobRecords
from jobs.settings import Settings
from jobs.signing import load_secret
from jobs.store import FileStore
from jobs.uploads import UploadStore
from service.event_hub import EventHub
from service.event_stream import EventSource
from service.field_cache import FieldCache
from service.frames import SharedFrames
from service.inspection import Inspector
from service.keys import KeyBook
from service.rates import Rates
from service.settings import ServiceSettings
from service.tasks import end


@dataclass(frozen=True)
class Services:
    """Shared by all requests; every part is safe to use from several threads.

    looks: records for routes that do not leave the event loop;
    longest_run_s: what workers allow one attempt at a job; webhook_hosts: see `Settings`, None
    where there are no webhooks.
    """

    settings: ServiceSettings
    redis: redis.Redis
    records: JobRecords
    looks: AsyncRecords
    store: FileStore
    uploads: UploadStore
    dispatcher: Dispatcher
    events: EventSource
    inspector: Inspector
    fields: FieldCache
    frames: SharedFrames
    keys: KeyBook
    rates: Rates
    longest_run_s: float
    webhook_hosts: tuple[str, ...] | None


@asynccontextmanager
async def running(settings: ServiceSettings, shared: Settings) -> AsyncIterator[Services]:
    """Connects everything and runs the event reader while the service is up."""
    connection, raw, streams = shared.connect(), shared.connect_raw(), shared.connect_async()
    pictures = shared.connect_async_raw()
    events = AsyncEvents(streams)
    hub = EventHub(events)
    records = JobRecords(connection, shared.lease_s)
    looks = AsyncRecords(streams)
    store = open_store(shared)
    services = Services(
        settings=settings,
        redis=connection,
        records=records,
        looks=looks,
        store=store,
        uploads=UploadStore(store.root, shared.upload_life_s),
        dispatcher=Dispatcher(raw, load_secret(shared), shared.job_timeout_s),
        events=EventSource(looks, events, hub),
        inspector=Inspector(settings),
        fields=FieldCache(),
        keys=KeyBook(streams),
        rates=Rates(streams),
        longest_run_s=shared.job_timeout_s,
        webhook_hosts=shared.webhook_hosts if shared.webhook_secret else None,
        frames=SharedFrames(AsyncPreviews(pictures)),
    )
    reader = asyncio.create_task(hub.run())
    try:
        yield services
    finally:
        await end(reader)
        services.fields.close()
        await streams.aclose()
        await pictures.aclose()
        connection.close()
        raw.close()


async def _services(connection: HTTPConnection) -> Services:
    # async, though it waits for nothing: a plain function would be sent to a thread each time
    found: Services = connection.app.state.services
    return found


Needs = Annotated[Services, Depends(_services)]
