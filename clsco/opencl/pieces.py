"""Splits launches into pieces of a fraction of a second, so that Ctrl-C, cancellation and progress are quick."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import pyopencl as cl

from clsco.opencl import pace
from clsco.opencl.session import Session

FIRST = 8  # the first piece of a launch is at most 1 / FIRST of it, as times of pieces may differ


def in_pieces(
    session: Session,
    key: Hashable,
    units: int,
    work: float,
    expected: float,
    enqueue: Callable[[int, int], cl.Event],
) -> list[cl.Event]:
    """Enqueue units 0 to `units` - 1 of a launch, piece by piece.

    Parameters
    ----------
    session : Session
    key : hashable
        Key shared by all launches that take the same time per unit of work.
    units : int
    work : float
        Work of all units; one unit of work is assumed to take UNIT seconds until measured.
    expected : float
        Expected seconds for all units.
    enqueue : callable
        enqueue(first, end) enqueues the units from `first` to before `end`, and returns the event.

    Returns
    -------
    list of Event
        Events of the pieces, in order.

    Raises
    ------
    CanceledError
        The work was canceled between two pieces.
    """
    progress = session.progress
    events: list[cl.Event] = []
    begin, end = 0, 0
    size = max(1, min(units // FIRST, int(units * pace.PIECE / expected)))
    while end < units:
        session.go_on()
        before, begin, end = end - begin, end, min(end + size, units)
        events.append(enqueue(begin, end))
        if len(events) > 1:  # one piece is enqueued while the previous one runs
            events[-2].wait()
            size = pace.next_size(before, pace.event_seconds(events[-2]))
        if progress is not None:
            progress.share = end / units
    session.pace.record_launch(key, work, events, pace.PIECE)
    return events
