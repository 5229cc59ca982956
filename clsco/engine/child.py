"""Child processes, connected to this process by a pipe, which end at the latest when this process ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

ORPHAN_S = 10.0  # s after which a process whose parent was killed is ended by force
_LARGEST = 31 << 20  # bytes, about the largest size of blocks that glibc can learn to reuse
_end_actions: list[Callable[[], object]] = []


class Child:
    """A child process that calls a function, connected to this process by a pipe.

    Ctrl-C reaches only this process, which decides when its children end. A child also ends when its parent ends, even
    if the parent is killed: the child then sends itself SIGTERM, and after ORPHAN_S seconds it exits by force. work:
    module-level function, called with the child's end of the pipe and `arguments`, which can be pickled; environ:
    additional environment variables; pipe: receives messages from the child, and raises EOFError after the child has
    ended.
    """

    def __init__(self, work: Callable[..., None], *arguments: Any, environ: Mapping[str, str] | None = None) -> None:
        context = multiprocessing.get_context("spawn")  # threads and drivers do not survive a fork
        self.pipe, child_pipe = context.Pipe()
        self._process = context.Process(target=_run, args=(work, child_pipe, arguments), daemon=True)
        before = {name: os.environ.get(name) for name in environ or ()}
        os.environ.update(environ or {})
        try:
            self._process.start()
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
        child_pipe.close()  # otherwise the pipe would not report the end of the child

    @property
    def pid(self) -> int:
        return self._process.pid or 0

    @property
    def is_alive(self) -> bool:
        return self._process.is_alive()

    def send(self, message: Any) -> None:
        """Send a message to the child; if the child has ended, this raises no error, but the next receive does."""
        with suppress(OSError):
            self.pipe.send(message)

    def terminate(self) -> None:
        """Ask the process to end, by SIGTERM."""
        self._process.terminate()

    def kill(self) -> None:
        """End the process at once, by SIGKILL, even if it is stopped."""
        self._process.kill()

    def end(self, patience: float = 1.0) -> int:
        """Wait for the process to end, and kill it after `patience` seconds; returns its exit status, or minus the
        number of the signal that ended it.
        """
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        with suppress(OSError):
            self.pipe.close()
        return self._process.exitcode or 0


def how_ended(status: int) -> str:
    """Description of a process's exit status."""
    return f"signal {-status}" if status < 0 else f"status {status}"


def at_forced_end(action: Callable[[], object]) -> None:
    """Register an action for this child process to run before it exits by force after the end of its parent."""
    _end_actions.append(action)


def _run(work: Callable[..., None], pipe: Connection, arguments: tuple[Any, ...]) -> None:
    """Entry point of the child process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # only Python prints: libraries that crash would add lines, though the parent handles it
        sys.stderr = open(os.dup(2), "w", buffering=1, errors="backslashreplace")  # noqa: SIM115
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    bytearray(_LARGEST)  # freed at once: from then on glibc keeps the pages of a picture for the next
    with suppress(EOFError, BrokenPipeError):  # the parent has closed the pipe
        work(pipe, *arguments)


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_S)
    for action in _end_actions:
        action()
    os._exit(1)
