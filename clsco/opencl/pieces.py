"""Splits launches into pieces of a fraction of a second, so that Ctrl-C and cancellation act quickly."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import pyopencl as cl

from clsco.opencl import pace
from clsco.opencl.session import Session

FIRST = 8  # the first piece is at most 1 / FIRST of a launch, because its parts may take different times


def in_pieces(
    session: Session, key: Hashable, units: int, work: float, expected: float, enqueue: Callable[[int, int], cl.Event]
) -> list[cl.Event]:
    """Enqueue a launch piece by piece; returns the events in order. Raises CanceledError before a piece.

    key: key of all launches that take the same time per unit of work; units: number of parts into which the launch can
    be cut; work: work of all parts, in units of `clsco.opencl.pace`; expected: expected seconds of the whole launch;
    enqueue(first, end): enqueues the parts from `first` up to but not including `end`, and returns the event.
    """
    events, begin, end = list[cl.Event](), 0, 0
    size = max(1, min(units // FIRST, int(units * pace.PIECE / expected)))
    while end < units:
        session.go_on()
        before, begin, end = end - begin, end, min(end + size, units)
        events.append(enqueue(begin, end))
        if len(events) > 1:  # one piece is enqueued while the previous one runs
            events[-2].wait()
            size = pace.next_size(before, pace.event_seconds(events[-2]))
        if session.progress is not None:
            session.progress.share = end / units
    session.pace.record_launch(key, work, events, pace.PIECE)
    return events
