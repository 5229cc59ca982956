"""An event loop that does not wait: when nothing else is to be done, its clock goes on to the next timer."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


class _Selector(selectors.DefaultSelector):
    """Takes no time; what it would have waited passes on its own clock."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(0.0 if timeout else timeout)
        if timeout and not found:
            self.now += timeout
        return found


class FastForward(asyncio.SelectorEventLoop):
    """Waits of tests end in their order, whatever else the machine does, and take no time."""

    def __init__(self) -> None:
        self._clock = _Selector()
        super().__init__(self._clock)

    def time(self) -> float:
        return self._clock.now


def run(work: Coroutine[Any, Any, T]) -> T:
    """As `asyncio.run`, on such a loop."""
    with asyncio.Runner(loop_factory=FastForward) as runner:
        return runner.run(work)
