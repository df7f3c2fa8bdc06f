"""`python -m service.write_openapi > docs/openapi.json`: the document for clients and reviewers."""

from __future__ import annotations

import json
import sys

from jobs.settings import Settings
from service.app import create_app
from service.settings import ServiceSettings


def text() -> str:
    """The document, the same on every machine."""
    document = create_app(ServiceSettings(), Settings()).openapi()
    return json.dumps(document, indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    sys.stdout.write(text())
