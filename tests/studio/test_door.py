"""Connections that say nothing, or too much, and cookies of other servers; and the browser that is opened."""

from __future__ import annotations

import asyncio
import http.server
import os
import re
import socket
import stat
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import httpx
import pytest

pytest.importorskip("starlette", reason="needs the extra clsco[studio]")

import uvicorn
from uvicorn.server import ServerState

from clsco.errors import ArgumentError
from clsco.studio import guard
from clsco.studio.guard import MOST_WAITING, close_half_open
from clsco.studio.listener import listen
from clsco.studio.server import MAX_HEADER
from tests.studio.browser import chromium, rest
from tests.studio.running import Running, studio, until

DEVICE = ()


def opened(running: Running) -> socket.socket:
    host, port = running.host.split(":")
    return socket.create_connection((host, int(port)), timeout=10)


def handles(running: Running) -> int:
    return len(list(Path(f"/proc/{running.process.pid}/fd").iterdir()))


def processor_seconds(running: Running) -> float:
    """Time that the server has computed, whatever else the machine does."""
    user, system = Path(f"/proc/{running.process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def test_connections_without_a_header_do_not_keep_others_out(running: Running) -> None:
    before, held = handles(running), list[socket.socket]()
    try:
        for k in range(825):
            held.append(opened(running))
            held[-1].sendall(b"GET / HTTP/1.1\r\nHost: "[: k % 20])
        with running.client() as client:
            assert client.get("/").status_code == 200
        until(lambda: handles(running) <= before + MOST_WAITING + 8, 10.0)
    finally:
        for each in held:
            each.close()


def test_connections_send_at_once() -> None:
    with listen("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        connection, _ = listener.accept()
        with connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_port_in_use_is_one_message() -> None:
    with listen("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        rule = rf"^port: must be free at 127\.0\.0\.1; got {port} \(Address already in use\)$"
        with pytest.raises(ArgumentError, match=rule):
            listen("127.0.0.1", port)


async def _app(scope: Any, receive: Any, send: Any) -> None:
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
    await send({"type": "http.response.body"})


async def _talk(*parts: bytes) -> bytes:
    """Answers of uvicorn to parts that are sent one after the other; it ends when the server ends the connection."""
    config, state = uvicorn.Config(_app, http="h11", log_level="critical"), ServerState()
    config.load()
    closing = asyncio.create_task(close_half_open(state.connections))
    made: Any = config.http_protocol_class
    server = await asyncio.get_running_loop().create_server(lambda: made(config, state, {}), "127.0.0.1", 0)
    reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
    answers = b""
    try:
        for part in parts:
            writer.write(part)
            await asyncio.sleep(0.02)
        async with asyncio.timeout(5):
            while chunk := await reader.read(2**16):
                answers += chunk
    except ConnectionError:
        pass
    finally:
        closing.cancel()
        writer.close()
        server.close()
    return answers


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "HEADER_SECONDS", 0.2)
    monkeypatch.setattr(guard, "TICK", 0.02)


@pytest.mark.parametrize(
    "parts",
    [
        (b"",),
        (b"GET / HTTP/1.1\r\n",),
        (b"GET / HTTP/1.1\r\n", *[b"A: b\r\n"] * 20),
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HT"),
    ],
)
def test_a_header_that_does_not_come_is_not_waited_for(impatient: None, parts: tuple[bytes, ...]) -> None:
    start = time.monotonic()
    assert (b"200 OK" in asyncio.run(_talk(*parts))) == (len(parts) == 2)
    assert time.monotonic() - start < 3.0


def test_a_body_is_no_header(impatient: None) -> None:
    head = b"POST / HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: 20\r\n\r\n"
    assert asyncio.run(_talk(head, *[b"a"] * 20)).startswith(b"HTTP/1.1 200")


def test_a_header_without_end_is_refused(running: Running) -> None:
    with opened(running) as connection, suppress(ConnectionError):  # the rest is not read
        connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nA: " + b"a" * 2 * MAX_HEADER)
        assert connection.recv(2**16).startswith(b"HTTP/1.1 400")


@pytest.mark.parametrize("other", ["a=" + "x" * 4000, 'a="' + "\\" * 4000, "a[]=b;c", "\xe4=\xf6", ";;=;", "="])
def test_cookies_of_others_do_not_lock_out(running: Running, other: str) -> None:
    cookies = {"Cookie": "; ".join([other] * (60 if len(other) > 99 else 4000) + [running.cookie["Cookie"]])}
    before = processor_seconds(running)
    answer = httpx.get(f"{running.page}/", headers=[(b"Cookie", cookies["Cookie"].encode("latin-1"))], timeout=30)
    assert answer.status_code == 200
    if other.isascii():
        with running.connect("/frames?tab=none", cookies, running.origin):
            pass
    assert processor_seconds(running) - before < 5.0  # it drew a page


def test_a_long_cookie_without_the_secret_costs_nothing(running: Running) -> None:
    before = processor_seconds(running)
    for quoted in ('a="' + "\\" * 60000, 'a="' + 'b;"' * 20000, "a=" + "b;" * 30000):
        assert httpx.get(f"{running.page}/", headers={"Cookie": quoted}).status_code == 403
    assert processor_seconds(running) - before < 3.0


def waiting_browser(folder: Path) -> tuple[str, Path]:
    """A command that writes down what it is to open, and does not end; and where it does."""
    script, said = folder / "browser", folder / "said"
    script.write_text(f'#!/bin/sh\nexec >{said}.part 2>&1\necho "$1"\nmv {said}.part {said}\nexec sleep 30\n')
    script.chmod(0o700)
    return str(script), said


def asked_to_open(said: Path) -> str:
    until(said.exists)
    return said.read_text().strip()


def test_a_browser_that_waits_is_not_waited_for_and_its_command_line_has_no_secret(tmp_path: Path) -> None:
    command, said = waiting_browser(tmp_path)
    (tmp_path / "root").mkdir()
    with studio(tmp_path / "root", browser=command) as running:
        with running.client() as client:
            assert client.get("/").status_code == 200
        address = asked_to_open(said)
        assert address.startswith("file:///")
        page = Path(unquote(urlsplit(address).path))
        assert stat.S_IMODE(page.parent.stat().st_mode) == 0o700
        assert running.address.rpartition("=")[2] not in page.read_text() + address
        found = re.search(r"url=(http://[^\"]+/\?c=[\w-]{43})\"", page.read_text())
        assert found is not None
        assert [httpx.get(found[1]).status_code for _ in range(3)] == [200, 403, 403]  # it works once
    assert not page.exists()


@pytest.mark.browser
def test_what_the_browser_is_opened_with_leads_to_the_page(tmp_path: Path) -> None:
    command, said = waiting_browser(tmp_path)
    (tmp_path / "root").mkdir()
    with studio(tmp_path / "root", "--device", "pocl", browser=command) as running, chromium() as context:
        page = context.new_page()
        page.goto(asked_to_open(said))
        rest(page)
        assert running.place in page.url


@pytest.mark.browser
def test_other_servers_of_the_machine_see_no_cookie(running: Running) -> None:
    seen: list[str | None] = []
    name, _, secret = running.cookie["Cookie"].partition("=")

    class Other(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            seen.append(self.headers.get("Cookie"))
            self.send_response(200)
            self.send_header("Set-Cookie", f"{name}=other; Path=/")
            self.end_headers()

        def log_message(self, *arguments: Any) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Other)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with chromium() as context:
            page = context.new_page()
            page.goto(running.address)
            rest(page)
            page.goto(f"http://127.0.0.1:{server.server_port}/")
            assert seen[0] is None
            assert secret not in str(seen)  # it may come twice, with its own cookie
            page.goto(f"{running.page}/")  # and theirs beside ours does not lock out
            rest(page)
    finally:
        server.shutdown()
        server.server_close()
