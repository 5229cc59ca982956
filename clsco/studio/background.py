"""Background tasks of the studio, which go on after errors, and objects that tell of their changes."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable

PAUSE = 1.0  # s after an error before a task starts again


class Observable:
    """Calls functions after its changes."""

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
    """Run a task again and again, also after errors, until canceled or until one of `ends`.

    `report` gets the messages of an error, not again while the error stays the same.
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
