"""Guard of the studio: checks the sender, origin and size of every request.

The studio listens on the loopback interface, which all users of the machine and all pages in the user's browser can
reach. So a request must name this server as its host (a foreign name that resolves to it is DNS rebinding), come from
the studio's own page, and have a cookie that is only given to a browser with the address printed at the start. Browsers
send cookies to all ports of a host, so the cookie is limited to a path that no other server knows.

When the studio has ended, another user can listen at its port. So an open page sends nothing there, neither path nor
cookie, before the server has proved at `/prove` that it knows the key of the page.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import secrets
import time
from collections.abc import Collection
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY = 64 * 2**20  # bytes of a request: an image
CODE_SECONDS = 120.0  # time in which the opened browser must use its code
HEADER_SECONDS = 10.0  # from the connection, or the end of the previous request, to the end of a header
MOST_WAITING = 64  # connections that wait for a header
TICK = 0.5  # s between checks of these connections
PROOF, MAX_NUMBER = "/prove", 64
"""Path at which the server proves its identity to a page, and most characters of the number that it signs."""

# The only inline script redirects the browser from the first address to the page; other scripts are our own files.
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
    """The outermost layer of the studio's server, for HTTP and WebSockets.

    `hosts` are the allowed values of the header Host, with the port. `token` is the secret of the first address,
    `/?t=`, which is exchanged for a cookie. `key` is kept for the next server at the same port, so that open pages
    reconnect; the unguessable `place` of everything except the first address, name of the `cookie`, and `proof_key`
    (hexadecimal), by which the server proves to its pages that it made them, are derived from it.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str], token: str, key: bytes) -> None:
        self.app = app
        self._hosts = frozenset(hosts)
        self._origins = frozenset(f"http://{host}" for host in hosts)
        self._token, self._session = token.encode(), secrets.token_urlsafe(32)
        self._code, self._code_ends = b"", 0.0
        port = next(iter(hosts)).rpartition(":")[2]
        self.place, self.cookie = f"/{_derived(key, f'place {port}')}", f"clsco-{_derived(key, f'cookie {port}')}"
        self.proof_key = hmac.digest(key, f"proof {port}".encode(), "sha256").hex()
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts) if not host.startswith("["))
        self._script = _GO_ON.format(place=self.place)
        digest = base64.b64encode(hashlib.sha256(self._script.encode()).digest()).decode()
        self._headers = {
            "content-security-policy": _POLICY.format(sockets=sockets, script=digest),
            "x-content-type-options": "nosniff",
            "x-frame-options": "DENY",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"].endswith("http.response.start"):
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        headers = Headers(scope=scope)
        if (rule := self._forgery(scope, headers)) is None and self._is_first(scope):
            await self._admit(scope, receive, send_with_headers)
        elif rule is None and scope["type"] == "http" and scope["path"] == PROOF:
            await self._prove(scope, receive, send_with_headers)
        elif (rule := rule or self._unknown(scope, headers)) is not None:
            close = {"connection": "close"}  # what is left of the body is not read
            await PlainTextResponse(f"refused: {rule}\n", 403, close)(scope, receive, send_with_headers)
        else:
            inside = {**scope, "root_path": self.place}
            limited = receive if scope["type"] == "websocket" else _limited(receive)
            await self.app(inside, limited, send_with_headers)

    def new_code(self) -> str:
        """A secret for the first address, `/?c=`, that works once, within a short time."""
        code = secrets.token_urlsafe(32)
        self._code, self._code_ends = code.encode(), time.monotonic() + CODE_SECONDS
        return code

    def _forgery(self, scope: Scope, headers: Headers) -> str | None:
        """The rule that a request breaks if it comes from another host or page; None if it breaks none."""
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return "Host must be this server"
        if len(origins) > 1 or not self._origins.issuperset(origins):
            return "Origin must be this server"
        if not origins and (scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")):
            return "Origin must be sent"
        return None

    def _unknown(self, scope: Scope, headers: Headers) -> str | None:
        """Reason why the sender is not authenticated, or None."""
        if any(site not in ("same-origin", "none") for site in headers.getlist("sec-fetch-site")):
            return "must come from the studio's own page"
        if not scope["path"].startswith(f"{self.place}/") or not self._has_cookie(headers):
            return "the address must be the one that `clsco studio` printed"
        return None

    def _has_cookie(self, headers: Headers) -> bool:
        """True if the request has the cookie, perhaps among cookies of other servers; compares in constant time."""
        parts = [part.strip().partition("=") for line in headers.getlist("cookie") for part in line.split(";")]
        values = [value for name, _, value in parts if name == self.cookie]
        return any(hmac.compare_digest(value.encode("latin-1"), self._session.encode()) for value in values)

    def _is_first(self, scope: Scope) -> bool:
        """True for a request to the first address with the token, or with an unused code, which is then used up."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return False
        kind, _, secret = scope["query_string"].partition(b"=")
        if kind == b"c" and time.monotonic() < self._code_ends and hmac.compare_digest(secret, self._code):
            self._code_ends = 0.0
            return True
        return bool(kind == b"t" and hmac.compare_digest(secret, self._token))

    async def _prove(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a page's random number with its code of authentication (HMAC-SHA256)."""
        number = scope["query_string"][:MAX_NUMBER]
        code = hmac.digest(bytes.fromhex(self.proof_key), number, "sha256").hex()
        await PlainTextResponse(code, headers={"cache-control": "no-store"})(scope, receive, send)

    async def _admit(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Exchange the secret in the address for a cookie, and redirect to an address without it.

        A script in a page redirects: after an HTTP redirect, the browser would take the request as one of the page with
        the link, and withhold the cookie.
        """
        cookie = f"{self.cookie}={self._session}; HttpOnly; SameSite=Strict; Path={self.place}/"
        headers = {"set-cookie": cookie, "cache-control": "no-store"}
        await HTMLResponse(_ADMITTED.format(script=self._script), headers=headers)(scope, receive, send)


def _derived(key: bytes, what: str) -> str:
    return base64.b32encode(hmac.digest(key, what.encode(), "sha256"))[:26].decode().lower()


def _limited(receive: Receive) -> Receive:
    """Wrap `receive` to raise HTTPException 413, which the application answers, when the body exceeds MAX_BODY."""
    count = 0

    async def counted() -> Message:
        nonlocal count
        message = await receive()
        count += len(message.get("body", b""))
        if count > MAX_BODY:
            raise HTTPException(413, f"a request must have at most {MAX_BODY >> 20} MiB", {"connection": "close"})
        return message

    return counted


async def close_half_open(connections: Collection[Any]) -> None:
    """Close connections of uvicorn whose request header is late, until canceled.

    uvicorn waits for a header without limit. If more than MOST_WAITING connections wait, the oldest are closed, so that
    clients that send a header at once are still served.
    """
    since: dict[Any, tuple[Any, float]] = {}  # previous request, and start of the wait for the next header
    while True:
        await asyncio.sleep(TICK)
        now = time.monotonic()
        waiting = [each for each in connections if _waits_for_header(each)]
        since = {
            each: known if (known := since.get(each)) and known[0] is each.cycle else (each.cycle, now)
            for each in waiting
        }
        oldest_first = sorted(waiting, key=lambda each: since[each][1])
        for place, each in enumerate(oldest_first):
            if now - since[each][1] > HEADER_SECONDS or place < len(oldest_first) - MOST_WAITING:
                each.transport.abort()


def _waits_for_header(connection: Any) -> bool:
    """True if a connection of uvicorn is between two requests; False for WebSockets."""
    cycle = getattr(connection, "cycle", connection)
    return cycle is None or getattr(cycle, "response_complete", False)
