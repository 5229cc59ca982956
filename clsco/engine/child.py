"""Processes that work for this one: begun, spoken with through a pipe, and ended in one way."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

ORPHAN_S = 10.0  # for the end of a process whose parent was killed
_LARGEST = 31 << 20  # B, of the blocks that glibc learns from
_last: list[Callable[[], object]] = []


class Child:
    """A process that calls a function, with a pipe between it and this one.

    Ctrl-C is for this process alone, which decides about its children. A child ends with this process, however that
    ends: first as SIGTERM ends it, and after ORPHAN_S by force.

    Parameters
    ----------
    work : callable
        Function of a module; takes the other end of the pipe, then `given`.
    *given : object
        Arguments that can be pickled.
    environ : mapping, optional
        Variables that the process has besides those of this one.

    Attributes
    ----------
    pipe : Connection
        Its messages, and EOFError at its end.
    """

    def __init__(self, work: Callable[..., None], *given: Any, environ: Mapping[str, str] | None = None) -> None:
        context = multiprocessing.get_context("spawn")  # threads and drivers do not survive a fork
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(work, theirs, given), daemon=True)
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
        theirs.close()  # so that its end is heard here

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid or 0

    @property
    def is_alive(self) -> bool:
        """True until it has ended."""
        return self._process.is_alive()

    def send(self, message: Any) -> None:
        """Send a message; one that has ended is heard to have ended when its next message is waited for."""
        with suppress(OSError):
            self.pipe.send(message)

    def terminate(self) -> None:
        """Ask the process to end."""
        self._process.terminate()

    def kill(self) -> None:
        """Have the process end at once, even one that is stopped."""
        self._process.kill()

    def end(self, patience: float = 1.0) -> int:
        """Wait until the process has ended, after so many seconds by force; returns its exit status, or less than 0
        for a signal."""
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        with suppress(OSError):
            self.pipe.close()
        return self._process.exitcode or 0


def how_ended(status: int) -> str:
    """Exit status of a process in words."""
    return f"signal {-status}" if status < 0 else f"status {status}"


def at_forced_end(action: Callable[[], object]) -> None:
    """Have a child, which calls this, do something before it ends by force because its parent was killed."""
    _last.append(action)


def _run(work: Callable[..., None], pipe: Connection, given: tuple[Any, ...]) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    bytearray(_LARGEST)  # once it was freed, glibc keeps the pages of each picture for the next
    with suppress(EOFError, BrokenPipeError):  # nobody waits any more
        work(pipe, *given)


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_S)
    for action in _last:
        action()
    os._exit(1)
