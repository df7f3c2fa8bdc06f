"""How the application is served."""

from __future__ import annotations

import uvicorn

from service.app import create_app
from service.settings import ServiceSettings


def server_for(settings: ServiceSettings) -> uvicorn.Server:
    """A server for this process; `run()` blocks until SIGINT or SIGTERM."""
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        access_log=False,
        log_config=None,  # as jobs.logs says, for all parts alike
        log_level="warning",  # handshakes are logged with their address, which may hold a ticket
        server_header=False,
        ws_max_size=64 * 1024,  # clients have nothing to say on a websocket
        ws_per_message_deflate=False,  # 44 KiB of memory a connection for hardly any gain
        timeout_graceful_shutdown=5,
    )
    return uvicorn.Server(config)
