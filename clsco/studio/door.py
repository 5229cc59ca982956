"""Connections to the studio before anybody knows who asks: what is sent there is bounded in size, time and number."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADER_SECONDS = 10.0  # from the connection, or the end of the request before, to the end of a header
MAX_HEADER = 2**18  # bytes: browsers send all cookies that the servers of this machine have left with them
MOST_WAITING = 64  # connections whose header has not come


def door(cookie: str) -> type[HttpToolsProtocol]:
    """The protocol of a server for HTTP.

    A connection whose header does not come in time, or is too large, is closed; and where too many wait for theirs, the
    one that has waited longest: whoever sends a header at once comes in. Who sends one without the cookie is answered
    and closed by the guard.

    Parameters
    ----------
    cookie : str
        Name of the one cookie that is handed on; those of other servers are dropped before anything reads them.
    """
    start = f"{cookie}=".encode()
    waiting: OrderedDict[_Door, None] = OrderedDict()

    class Door(_Door):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self.start, self.waiting = start, waiting

    return Door


class _Door(HttpToolsProtocol):
    start: bytes
    waiting: OrderedDict[_Door, None]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._timer: asyncio.TimerHandle | None = None
        self._wait()

    def data_received(self, data: bytes) -> None:
        if self._timer is None and (self.cycle is None or self.cycle.response_complete):
            self._wait()  # for the next request of a connection that is kept
        self._size += len(data)
        super().data_received(data)
        if self._timer is not None and self._size > MAX_HEADER:
            self._arrived()
            self.send_400_response(f"a request header must have at most {MAX_HEADER >> 10} KiB")

    def on_header(self, name: bytes, value: bytes) -> None:
        if name.lower() == b"cookie":
            value = b"; ".join(part for part in map(bytes.strip, value.split(b";")) if part.startswith(self.start))
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        self._arrived()
        super().on_headers_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        self._arrived()
        super().connection_lost(exc)

    def _wait(self) -> None:
        """Let a header come from now on."""
        self._size = 0
        self._timer = self.loop.call_later(HEADER_SECONDS, self._give_up)
        self.waiting[self] = None
        if len(self.waiting) > MOST_WAITING:
            next(iter(self.waiting))._give_up()

    def _arrived(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
            del self.waiting[self]

    def _give_up(self) -> None:
        self._arrived()
        self.transport.abort()
