"""`python -m service`: the API alone, with Redis and workers running elsewhere."""

from __future__ import annotations

import logging
import sys

from service.server import server_for
from service.settings import SettingsError, from_environment
from udflow.errors import UdflowError


def main() -> int:
    """The exit code."""
    try:
        server_for(from_environment()).run()
    except (SettingsError, UdflowError) as error:
        logging.getLogger("service").error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
