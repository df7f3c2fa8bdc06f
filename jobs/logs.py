"""Logs: lines for people, or with UDFLOW_LOG=json objects for machines. Keys are never logged."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from datetime import UTC, datetime

from jobs.errors import BadSetting

_FORMS = ("text", "json")


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, logger, message, and the record's `fields`."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        moment = datetime.fromtimestamp(record.created, UTC)
        values = {
            "time": moment.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            values["traceback"] = self.formatException(record.exc_info)
        return json.dumps(values, default=str)


def configure(environ: Mapping[str, str] = os.environ) -> None:
    """Set up this process's log on standard error.

    Raises:
        BadSetting: UDFLOW_LOG is neither text nor json.
    """
    form = environ.get("UDFLOW_LOG") or "text"
    if form not in _FORMS:
        raise BadSetting(f'UDFLOW_LOG is {form!r}; choose "text" or "json"')
    handler = logging.StreamHandler()
    plain = logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    handler.setFormatter(JsonLines() if form == "json" else plain)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
