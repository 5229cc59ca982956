"""Address of the studio, and the socket that listens there."""

from __future__ import annotations

import os
import secrets
import socket

from clsco.errors import ArgumentError


def own_address() -> str:
    """A random address in 127.0.0.0/8 that no other server is likely to use; 127.0.0.1 if the system has no others.

    Another server at the same address and port could read and change what this server stores in a browser.
    """
    host = f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"
    try:
        socket.create_server((host, 0)).close()
    except OSError:
        return "127.0.0.1"
    return host


def listen(host: str, port: int) -> socket.socket:
    """Open a socket whose connections send without delay. Raises ArgumentError if the port is in use.

    A picture is several packets, and the kernel would hold back the last one until the browser acknowledges the others.
    asyncio disables that only for sockets with an explicit protocol, which sockets from `create_server` do not have.
    """
    try:
        listener = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise ArgumentError(f"port: must be free at {host}; got {port} ({os.strerror(error.errno or 0)})") from None
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener
