"""Guard before every request to the studio: checks who asks, from where, and how much is sent.

The studio listens on the loopback interface, which all users of the machine and all pages in the user's browser reach.
So a request must name this server as its host (a foreign name that points here is DNS rebinding), come from the
studio's own page, and bring a cookie that only who has the address printed at the start is given. Browsers send cookies
to all ports of a host, so it is one of a path that no other server knows.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import secrets
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection, Iterable, MutableMapping
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

MAX_BODY = 64 * 2**20  # bytes of a request: an image
MAX_MESSAGE = 2**20  # bytes from a WebSocket
CODE_SECONDS = 120.0  # in which the browser that is opened has to come
TOO_LARGE, TOO_BIG_A_MESSAGE = 413, 1009

# The one script in a page is that which goes from the first address to the next; others are files of ours.
_POLICY = (
    "default-src 'self'; script-src 'self' 'sha256-{script}'; img-src 'self' data: blob:; "
    "connect-src 'self' {sockets}; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_GO_ON = 'location.replace("{place}/" + location.hash)'  # a link's scene is in the fragment of the address
_ADMITTED = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>clsco studio</title>
<script>{script}</script>
<noscript>The studio needs JavaScript.</noscript>
"""


class Guard:
    """The outermost layer of the studio's server, for HTTP and WebSockets alike.

    Parameters
    ----------
    app : ASGI application
        Application to guard.
    hosts : collection of str
        Allowed values of the header Host, with the port.
    token : str
        The secret of the first address, `/?t=`, which gives a cookie for this server alone.
    key : bytes
        Another secret, which is the same for the next server at the same port, so that pages find it.

    Attributes
    ----------
    place : str
        Path of all that there is, but for the first address; nobody can guess it.
    cookie : str
        Name of the cookie, which nobody can guess, either.
    """

    def __init__(self, app: Application, hosts: Collection[str], token: str, key: bytes) -> None:
        self.app = app
        self._hosts = frozenset(hosts)
        self._origins = frozenset(f"http://{host}" for host in hosts)
        self._token, self._session = token.encode(), secrets.token_urlsafe(32).encode()
        self._code, self._code_ends = b"", 0.0
        port = next(iter(hosts)).rpartition(":")[2]
        self.place, self.cookie = f"/{_derived(key, f'place {port}')}", f"clsco-{_derived(key, f'cookie {port}')}"
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts) if not host.startswith("["))
        self._script = _GO_ON.format(place=self.place)
        digest = base64.b64encode(hashlib.sha256(self._script.encode()).digest()).decode()
        self._headers = [
            (b"content-security-policy", _POLICY.format(sockets=sockets, script=digest).encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"x-frame-options", b"DENY"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cross-origin-resource-policy", b"same-origin"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = _headers_of(scope)
        if (rule := self._refusal(scope, headers)) is not None:
            await self._refuse(scope, send, 403, rule)
        elif self._is_first(scope):
            await self._admit(send)
        elif (rule := self._unknown(scope, headers)) is not None:
            await self._refuse(scope, send, 403, rule)
        else:
            inside = {**scope, "root_path": self.place}
            if scope["type"] == "websocket":
                await self.app(inside, _counted_socket(receive, send), send)
            else:
                await self._limited(inside, headers, receive, send)

    def new_code(self) -> str:
        """A secret for the first address, `/?c=`, that works once, and soon."""
        code = secrets.token_urlsafe(32)
        self._code, self._code_ends = code.encode(), time.monotonic() + CODE_SECONDS
        return code

    def _refusal(self, scope: Scope, headers: dict[str, list[str]]) -> str | None:
        """The rule that a request breaks, whatever it asks for."""
        if len(headers.get("host", ())) != 1 or headers["host"][0] not in self._hosts:
            return "Host must be this server"
        origins = headers.get("origin", [])
        if any(origin not in self._origins for origin in origins) or len(origins) > 1:
            return "Origin must be this server"
        needs_origin = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if needs_origin and not origins:
            return "Origin must be sent"
        return None

    def _unknown(self, scope: Scope, headers: dict[str, list[str]]) -> str | None:
        """Why it is not known who asks."""
        if any(site not in ("same-origin", "none") for site in headers.get("sec-fetch-site", ())):
            return "must come from the studio's own page"
        if not scope["path"].startswith(f"{self.place}/") or not self._has_cookie(headers):
            return "the address must be the one that `clsco studio` printed"
        return None

    def _has_cookie(self, headers: dict[str, list[str]]) -> bool:
        """Test whether the cookie came along, in constant time."""
        for line in headers.get("cookie", ()):
            for part in line.split(";"):
                name, _, value = part.strip().partition("=")
                if name == self.cookie and hmac.compare_digest(value.encode(), self._session):
                    return True
        return False

    def _is_first(self, scope: Scope) -> bool:
        """Test whether this is the printed address, or the one that the browser was opened with."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return False
        kind, _, given = scope["query_string"].partition(b"=")
        if kind == b"c" and time.monotonic() < self._code_ends and hmac.compare_digest(given, self._code):
            self._code_ends = 0.0
            return True
        return bool(kind == b"t" and hmac.compare_digest(given, self._token))

    async def _admit(self, send: Send) -> None:
        """Turn the secret of the address into a cookie, and go to an address without it.

        By a page, as a redirection would count as of the page that led here, which gets no such cookie.
        """
        cookie = f"{self.cookie}={self._session.decode()}; HttpOnly; SameSite=Strict; Path={self.place}/"
        headers = [(b"set-cookie", cookie.encode()), (b"cache-control", b"no-store"), *self._headers]
        await _respond(send, 200, headers, _ADMITTED.format(script=self._script).encode(), b"text/html; charset=utf-8")

    async def _refuse(self, scope: Scope, send: Send, status: int, rule: str) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": rule})  # before it opens: HTTP 403
            return
        # What is left of the body is not read.
        await _respond(send, status, [*self._headers, (b"connection", b"close")], f"refused: {rule}\n".encode())

    async def _limited(self, scope: Scope, headers: dict[str, list[str]], receive: Receive, send: Send) -> None:
        """Let a request through, with headers of ours, as long as its body is small enough."""
        started, ended, count = False, False, 0
        is_read = "content-length" not in headers and "transfer-encoding" not in headers
        rule = f"a request must have at most {MAX_BODY >> 20} MiB"
        (length, *_) = headers.get("content-length", ["0"])
        if not length.isdecimal() or len(length) > 18 or int(length) > MAX_BODY:
            await self._refuse(scope, send, TOO_LARGE, rule)
            return

        async def counted() -> Message:
            nonlocal count, ended, is_read
            if ended:
                return {"type": "http.disconnect"}
            message = await receive()
            count += len(message.get("body", b""))
            if count > MAX_BODY:
                ended = True
                if not started:
                    await self._refuse(scope, send, TOO_LARGE, rule)
                return {"type": "http.disconnect"}
            is_read = is_read or not message.get("more_body", False)
            return message

        async def with_headers(message: Message) -> None:
            nonlocal started
            if ended:
                return
            if message["type"] == "http.response.start":
                started = True
                message["headers"] = [*_others(message.get("headers", ()), self._headers), *self._headers]
                if not is_read:  # what is left of the body is not waited for
                    message["headers"].append((b"connection", b"close"))
            await send(message)

        try:
            await self.app(scope, counted, with_headers)
        except Exception:
            if not ended:  # else it is about the end that was told
                raise


def _derived(key: bytes, what: str) -> str:
    return base64.b32encode(hmac.digest(key, what.encode(), "sha256"))[:26].decode().lower()


def _headers_of(scope: Scope) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return found


def _others(headers: Iterable[tuple[bytes, bytes]], ours: Iterable[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    names = {name for name, _ in ours}
    return [(name, value) for name, value in headers if name.lower() not in names]


def _counted_socket(receive: Receive, send: Send) -> Receive:
    """Messages of a WebSocket, until one is too long, which ends it."""
    ended = False

    async def counted() -> Message:
        nonlocal ended
        if not ended:
            message = await receive()
            size = len(message.get("bytes") or b"") + len(message.get("text") or "")
            if size <= MAX_MESSAGE:
                return message
            ended = True
            await send({"type": "websocket.close", "code": TOO_BIG_A_MESSAGE})
        return {"type": "websocket.disconnect", "code": TOO_BIG_A_MESSAGE}

    return counted


async def _respond(
    send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes, kind: bytes = b"text/plain; charset=utf-8"
) -> None:
    about = [(b"content-type", kind), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": [*about, *headers]})
    await send({"type": "http.response.body", "body": body})


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
