"""A studio that runs, as a process of its own, and what a browser sends to it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin


@dataclass(frozen=True)
class Running:
    """Address, secret and process of a studio."""

    address: str
    process: subprocess.Popen[str]

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
    def cookie(self) -> dict[str, str]:
        """What a browser sends after the first address."""
        return {"Cookie": f"clsco-{self.host.rpartition(':')[2]}={self.address.rpartition('=')[2]}"}

    def frames(self, tab: str) -> ClientConnection:
        """The socket of a tab."""
        return self.connect(f"/frames?tab={tab}", self.cookie, self.origin)

    def connect(self, path: str, headers: dict[str, str], origin: str | None) -> ClientConnection:
        """Open a socket, as any page might."""
        given = None if origin is None else Origin(origin)
        return connect(self.sockets + path, additional_headers=headers, origin=given, proxy=None, max_size=2**26)

    def client(self) -> httpx.Client:
        """A browser's requests from the studio's own page."""
        return httpx.Client(base_url=self.origin, headers={**self.cookie, "Origin": self.origin}, timeout=20)


@contextmanager
def studio(root: Path, *arguments: str) -> Iterator[Running]:
    """Start `clsco studio`, and end it."""
    command = [str(Path(sys.executable).parent / "clsco"), "studio", "--no-browser", "--root", str(root), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        assert line.startswith("http://"), process.stderr.read()
        yield Running(line.strip(), process)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
