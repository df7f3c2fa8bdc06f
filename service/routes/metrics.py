"""Figures for Prometheus: of all jobs from Redis, of this process from its memory."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse
from redis.exceptions import RedisError

from jobs import keys
from service.services import Needs, Services
from service.traffic import BUCKETS_S, Traffic
from udflow import __version__

router = APIRouter(tags=["system"])
_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Labels = Mapping[str, object]


@router.get(
    "/metrics",
    operation_id="getMetrics",
    summary="Figures for Prometheus",
    response_class=PlainTextResponse,
)
def get_metrics(request: Request, services: Needs) -> PlainTextResponse:
    """Queue, jobs, workers and memory; requests and websockets of the process that answers."""
    lines = [*_jobs(services), *_process(services), *_requests(request.app.state.traffic)]
    return PlainTextResponse("\n".join(lines) + "\n", media_type=_CONTENT_TYPE)


def _family(name: str, kind: str, about: str, samples: Mapping[str, Any] | float) -> Iterator[str]:
    """One metric. samples: a number, or numbers by their labels as text."""
    yield f"# HELP udflow_{name} {about}"
    yield f"# TYPE udflow_{name} {kind}"
    values = samples if isinstance(samples, Mapping) else {"": samples}
    for labels, value in values.items():
        yield f"udflow_{name}{labels} {value}"


def _labels(**values: object) -> str:
    texts = (f'{name}="{str(value).translate(_ESCAPES)}"' for name, value in values.items())
    return "{" + ",".join(texts) + "}"


_ESCAPES = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


def _jobs(services: Services) -> Iterator[str]:
    try:
        waiting, running = services.records.queued(), services.records.active()
        now, workers = services.records.now(), services.dispatcher.workers()
        counted: Any = services.redis.hgetall(keys.COUNTERS)
        webhooks: Any = services.redis.zcard(keys.WEBHOOKS)
    except RedisError:
        yield from _family("redis_up", "gauge", "Whether Redis answers", 0)
        return
    yield from _family("redis_up", "gauge", "Whether Redis answers", 1)
    yield from _family("jobs_waiting", "gauge", "Jobs in the queue", len(waiting))
    oldest = max((now - record.created_at for record in waiting), default=0.0)
    yield from _family("oldest_wait_seconds", "gauge", "Age of the oldest waiting job", oldest)
    yield from _family("jobs_running", "gauge", "Jobs at work", len(running))
    yield from _family("workers", "gauge", "Workers heard of lately", workers)
    yield from _family("webhooks_waiting", "gauge", "Webhooks to be sent", webhooks)
    named = (
        ("jobs_total", "Jobs that ended", "state", "jobs"),
        ("stage_seconds_total", "Seconds spent in each stage of finished jobs", "stage", "seconds"),
        ("points_total", "Points of finished jobs", "kind", "points"),
        ("workers_lost_total", "Attempts that ended with their worker", "reason", "workers"),
    )
    for name, about, label, prefix in named:
        found = {
            _labels(**{label: field.partition(":")[2]}): value
            for field, value in sorted(counted.items())
            if field.partition(":")[0] == prefix
        }
        yield from _family(name, "counter", about, found)


def _process(services: Services) -> Iterator[str]:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    memory = peak if sys.platform == "darwin" else peak * 1024
    yield from _family("info", "gauge", "The version", {_labels(version=__version__): 1})
    yield from _family("api_memory_peak_bytes", "gauge", "Peak memory of this process", memory)
    watchers = services.events.hub.watcher_count()
    yield from _family("watchers", "gauge", "Open event streams and long polls here", watchers)
    free = services.store.free_bytes()
    yield from _family("disk_free_bytes", "gauge", "Room in the data folder", free)


def _requests(traffic: Traffic) -> Iterator[str]:
    requests = {
        _labels(method=method, route=route, status=status): count
        for (method, route, status), count in sorted(traffic.requests.items())
    }
    yield from _family("requests_total", "counter", "Requests answered here", requests)
    yield from _family("received_bytes_total", "counter", "Bytes of bodies", traffic.received)
    name = "request_seconds"
    yield f"# HELP udflow_{name} Time to answer, by route"
    yield f"# TYPE udflow_{name} histogram"
    for route in sorted(traffic.seconds):
        total = 0
        for bound in (*BUCKETS_S, float("inf")):
            total += traffic.buckets[route, bound]
            limit = "+Inf" if bound == float("inf") else f"{bound:g}"
            yield f"udflow_{name}_bucket{_labels(route=route, le=limit)} {total}"
        yield f"udflow_{name}_sum{_labels(route=route)} {traffic.seconds[route]}"
        yield f"udflow_{name}_count{_labels(route=route)} {total}"
