"""Background tasks of the studio, which continue after errors, and objects that notify listeners of changes."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable

PAUSE = 1.0  # s after an error before a task starts again


class Observable:
    """Object that calls its listeners after each of its changes."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a function after each change; returns a function that unsubscribes it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def _tell(self) -> None:
        for listener in tuple(self._listeners):
            listener()


async def keep_running(
    task: Callable[[], Awaitable[None]],
    report: Callable[[list[str]], Awaitable[None]],
    ends: tuple[type[Exception], ...] = (),
) -> None:
    """Run a task repeatedly, also after errors, until it is canceled or raises one of the exceptions in `ends`.

    report: called with the messages of an error, but only once while the same error repeats.
    """
    last = ""
    while True:
        try:
            await task()
            last = ""
        except ends:
            return
        except Exception as error:
            message = f"studio: must not fail; got {type(error).__name__}: {error}"
            if message != last:
                traceback.print_exc()
                await report([message])
            last = message
            await asyncio.sleep(PAUSE)
