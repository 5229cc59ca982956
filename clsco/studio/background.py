"""Background tasks of the studio: an error is logged and reported to the page, and the task goes on."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable

PAUSE = 1.0
"""Seconds after an error before a task starts again."""


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
