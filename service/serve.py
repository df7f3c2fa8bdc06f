"""`python -m service.serve`: the API on UDFLOW_HOST and PORT, or on a socket that is handed down.

With UDFLOW_LISTEN_FD the listening socket belongs to the supervisor: it stays open while the API
is restarted, so callers wait instead of being refused.
"""

from __future__ import annotations

import logging
import os
import socket
import sys

from jobs.logs import configure
from service.listening import CannotListen, listen
from service.server import server_for
from service.settings import ServiceSettings, SettingsError, from_environment
from udflow.errors import UdflowError


def main() -> int:
    """Serve until SIGTERM. The exit code."""
    try:
        configure()
        settings = from_environment()
        server_for(settings).run(sockets=[_socket(settings)])
    except (SettingsError, CannotListen, UdflowError) as error:
        logging.getLogger("service").error("%s", error)
        return 1
    return 0


def _socket(settings: ServiceSettings) -> socket.socket:
    handed_down = os.environ.get("UDFLOW_LISTEN_FD")
    if handed_down:
        return socket.socket(fileno=int(handed_down))
    return listen(settings.host, settings.port)


if __name__ == "__main__":
    sys.exit(main())
