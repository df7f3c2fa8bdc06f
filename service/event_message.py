"""One event as clients are told it, put into words once however many there are."""

from __future__ import annotations

import json
from functools import cached_property
from typing import Any

from jobs.events import Event
from service.job_view import timestamp


class Message:
    """An event of a job as it is sent. id: None for a heartbeat, which cannot be resumed from."""

    def __init__(self, id: str | None, type: str, seconds: float, data: dict[str, Any]) -> None:
        self.id = id
        self.type = type
        self.seconds = seconds
        self.data = data

    @classmethod
    def of(cls, event: Event) -> Message:
        """A stored event."""
        return cls(event.id, event.type, event.time, event.data)

    @cached_property
    def values(self) -> dict[str, Any]:
        """As JSON values."""
        time = timestamp(self.seconds)
        if self.id is None:
            return {"type": self.type, "time": time}
        return {"id": self.id, "type": self.type, "time": time, "data": self.data}

    @cached_property
    def text(self) -> str:
        """As a websocket carries it."""
        return json.dumps(self.values)

    @cached_property
    def frame(self) -> str:
        """As a stream of server-sent events carries it."""
        if self.id is None:
            return f": {self.type}\n\n"
        return f"id: {self.id}\nevent: {self.type}\ndata: {self.text}\n\n"
