"""The listening socket of the API."""

from __future__ import annotations

import socket

_SILENT_PEER_MS = 10_000  # unacknowledged data for so long: the peer has vanished


class CannotListen(Exception):
    """The address cannot be used. The message says why and what to do."""


def listen(host: str, port: int) -> socket.socket:
    """A bound and listening socket.

    Raises:
        CannotListen: the port is taken, not allowed, or the address is not this machine's.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        server = socket.socket(family, kind, protocol)
    except OSError as error:
        raise CannotListen(f"UDFLOW_HOST={host} is no address of this machine: {error}") from error
    try:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            server.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _SILENT_PEER_MS)
        server.bind(address)
        server.listen(1024)
    except OSError as error:
        server.close()
        another = port + 1 if port < 65535 else 8000
        raise CannotListen(
            f"port {port} on {host} cannot be used ({error.strerror}); stop the program that has "
            f"it, or choose another port, for example PORT={another} make up"
        ) from error
    return server
