"""Pacing of launches: measures their times, and limits the host's lead over the device to a fraction of a second.

Python handles a signal only when a call of OpenCL returns, and enqueued commands cannot be revoked. So long launches
are cut into pieces, sized by the times of earlier pieces, and the host is at most a fraction of a second ahead of the
device. Short launches are enqueued at once, without waiting.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import pyopencl as cl

PIECE = 0.1  # time in s of a piece, and lead of the host over the device at which the host waits
AT_ONCE = 16  # number of short launches in that lead; few, as they may take longer than expected
TIMED = 8  # one of this many launches of a short kernel is timed
GROWTH = 4  # largest ratio of the size of a piece to that of the previous piece
UNIT = 25e-9  # time in s of a unit of work until one is measured, about that of a kernel for a pixel

_END, _START = cl.profiling_info.END, cl.profiling_info.START


class Pace:
    """Times of the kernels of a queue, and the host's lead over the device."""

    def __init__(self) -> None:
        self._rates: dict[Hashable, float] = {}  # s per unit of work
        self._pending: dict[Hashable, tuple[list[cl.Event], float]] = {}
        self._untimed: dict[Hashable, int] = {}  # launches until one is timed
        self._ahead = 0.0
        self._mark: cl.Event | None = None

    def expected(self, key: Hashable, work: float) -> float:
        """Expected seconds for `work` units of work of a kernel, from the kernel's latest measured time."""
        if (pending := self._pending.get(key)) is not None:
            events, done = pending
            if (status := events[-1].command_execution_status) <= 0:  # done, or failed
                del self._pending[key]
                if status == 0:
                    self.record_time(key, done, sum(map(event_seconds, events)))
        return self._rates.get(key, UNIT) * work

    def record_launch(self, key: Hashable, work: float, events: list[cl.Event], seconds: float) -> None:
        """Record a launch; wait if the host is too far ahead of the device. seconds: expected time of the launch."""
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
        """Record the seconds that an amount of work took."""
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
    """Size of the next piece, after a piece of `size` that took `seconds`."""
    return max(1, int(size * min(PIECE / max(seconds, 1e-9), GROWTH)))
