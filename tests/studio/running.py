"""A studio that runs, as a process of its own, and what a browser sends to it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

START = '[[object]]\nshape = "plane"\n'


@dataclass(frozen=True)
class Running:
    """Address, process, path and cookie of a studio."""

    address: str
    process: subprocess.Popen[str]
    place: str
    cookie: dict[str, str]  # what a browser sends after the first address

    @property
    def origin(self) -> str:
        parts = urlsplit(self.address)
        return f"{parts.scheme}://{parts.netloc}"

    @property
    def host(self) -> str:
        return urlsplit(self.address).netloc

    @property
    def sockets(self) -> str:
        return f"ws://{self.host}"

    @property
    def page(self) -> str:
        """Address of the page itself."""
        return f"{self.origin}{self.place}"

    def frames(self, tab: str) -> ClientConnection:
        """The socket of a tab."""
        return self.connect(f"/frames?tab={tab}", self.cookie, self.origin)

    def connect(self, path: str, headers: dict[str, str], origin: str | None) -> ClientConnection:
        """Open a socket, as any page might."""
        given = None if origin is None else Origin(origin)
        return connect(
            self.sockets + self.place + path, additional_headers=headers, origin=given, proxy=None, max_size=2**26
        )

    def client(self) -> httpx.Client:
        """A browser's requests from the studio's own page."""
        return httpx.Client(
            base_url=self.page, headers={**self.cookie, "Origin": self.origin}, timeout=20, trust_env=False
        )


def until(holds: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait until something is true."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


@contextmanager
def studio(root: Path, *arguments: str, browser: str = "") -> Iterator[Running]:
    """Start `clsco studio`, by default with START, and end it, without a traceback; browser: what it opens."""
    if not any(word.endswith(".toml") for word in arguments):
        root.mkdir(exist_ok=True)
        (root / "start.toml").write_text(START)
        arguments = (*arguments, str(root / "start.toml"))
    command = [str(Path(sys.executable).parent / "clsco"), "studio", "--root", str(root), *arguments]
    command += [] if browser else ["--no-browser"]
    environment = {**os.environ, "BROWSER": browser}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        assert line.startswith("http://"), process.stderr.read()
        answer = httpx.get(line.strip(), timeout=30, trust_env=False)
        place = re.search(r'"(/\w+)/"', answer.text)
        assert place is not None, answer.text
        yield Running(line.strip(), process, place[1], {"Cookie": answer.headers["set-cookie"].partition(";")[0]})
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            _, said = process.communicate()
    assert "Traceback" not in said, said
