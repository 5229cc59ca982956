"""Pacing of launches: measures their times, and keeps the host at most a fraction of a second ahead of the device.

Python handles a signal such as Ctrl-C only when a call of OpenCL returns, and enqueued commands cannot be revoked. So
long launches are cut into pieces, whose size follows from the times of earlier pieces, and the host waits if it is too
far ahead. Short launches are enqueued at once, without waiting.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import pyopencl as cl

PIECE = 0.1  # time in s that a piece should take; also the time ahead of the device from which on the host waits
AT_ONCE = 16  # most short launches ahead of the device; few, as they may take longer than expected
TIMED = 8  # one of this many launches of a short kernel is timed
GROWTH = 4  # largest ratio of a piece's size to the size of the previous piece
UNIT = 25e-9  # assumed time in s of a unit of work, about that of a kernel per pixel, until it is measured

_END, _START = cl.profiling_info.END, cl.profiling_info.START


class Pace:
    """Records the times of the kernels of a queue, and how far the host is ahead of the device."""

    def __init__(self) -> None:
        self._rates: dict[Hashable, float] = {}  # s per unit of work
        self._pending: dict[Hashable, tuple[list[cl.Event], float]] = {}
        self._untimed: dict[Hashable, int] = {}  # number of launches until the next timed one
        self._ahead = 0.0
        self._mark: cl.Event | None = None

    def expected(self, key: Hashable, work: float) -> float:
        """Expected seconds for `work` units of work, from the latest measured time of launches with this `key`."""
        if (pending := self._pending.get(key)) is not None:
            events, done = pending
            if (status := events[-1].command_execution_status) <= 0:  # done, or failed
                del self._pending[key]
                if status == 0:
                    self.record_time(key, done, sum(map(event_seconds, events)))
        return self._rates.get(key, UNIT) * work

    def record_launch(self, key: Hashable, work: float, events: list[cl.Event], seconds: float) -> None:
        """Record a launch of `work` units, expected to take `seconds`; wait if the host is too far ahead."""
        if untimed := self._untimed.get(key, 0):
            self._untimed[key] = untimed - 1
        elif key not in self._pending:
            self._pending[key] = events, work
        self._ahead += max(seconds, PIECE / AT_ONCE)
        if self._ahead > PIECE:
            if self._mark is not None:
                self._mark.wait()
            self._mark, self._ahead = events[-1], 0.0

    def record_time(self, key: Hashable, work: float, seconds: float) -> None:
        """Record the seconds that `work` units of work took."""
        self._rates[key] = seconds / work
        self._untimed[key] = TIMED - 1 if seconds < PIECE / AT_ONCE else 0

    def clear(self) -> None:
        """Remove all records."""
        self._rates.clear()
        self._pending.clear()
        self._untimed.clear()
        self._mark, self._ahead = None, 0.0


def event_seconds(event: cl.Event) -> float:
    """Seconds that a completed command took on the device."""
    info: Any = event.get_profiling_info
    return 1e-9 * float(info(_END) - info(_START))


def next_size(size: int, seconds: float) -> int:
    """Size of the next piece, after a piece of size `size` that took `seconds`."""
    return max(1, int(size * min(PIECE / max(seconds, 1e-9), GROWTH)))
