"""Shows progress: as a bar on a terminal or, if requested, as lines of JSON on stderr for programs."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from clsco.opencl.session import Progress

FORM = "clsco.progress"  # key, in a command's context, of the requested form of progress
LINES_S = 0.2  # s between lines of JSON
WITHIN_S = 1.0  # s between lines within a frame


@contextmanager
def progress(
    total: int, quiet: bool, what: str = "frames", here: Progress | None = None
) -> Iterator[Callable[..., object]]:
    """Show a bar on a terminal, or lines of JSON if requested; yields a function to call after one or more items.

    what: plural of the name of the items. here: position of the device within a frame, which is shown, too.
    """
    if _is_in_lines():
        with _lines(total, what, here) as advance:
            yield advance
        return
    if not _is_shown(total, quiet):
        yield lambda _count=1: None
        return
    from rich import progress as rich
    from rich.console import Console
    from rich.text import Text

    columns = [rich.TextColumn(what), rich.BarColumn(), rich.MofNCompleteColumn(), rich.TimeElapsedColumn()]
    if here is not None:
        device = here

        class Position(rich.ProgressColumn):
            def render(self, task: rich.Task) -> Text:
                return Text(position(device, task.completed, total, task.elapsed or 0.0))

        columns.append(Position())
    with rich.Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=total)
        yield lambda count=1: bar.advance(task, count)


@contextmanager
def frame_progress(total: int, quiet: bool, device: str | None) -> Iterator[Callable[[], object]]:
    """Show progress like `progress`, and also the device's position within a frame and the time left."""
    if not _is_in_lines() and not _is_shown(total, quiet):
        yield lambda: None
        return
    from clsco.opencl.session import Progress, session_for

    session = session_for(device)
    session.progress = here = Progress()
    try:
        with progress(total, quiet, here=here) as advance:

            def after_frame() -> None:
                here.done = 0
                advance()

            yield after_frame
    finally:
        session.progress = None


def position(here: Progress, done: float, total: int, elapsed: float) -> str:
    """Text of a position in a frame: the step, its finished fraction, the time sample and, if known, the time left."""
    share = f" {here.share:.0%}" if 0.0 < here.share < 1.0 else ""
    sample = f"time sample {min(here.done + 1, here.total)} of {here.total}" if here.total > 1 else ""
    left = _seconds_left(here, done, total, elapsed)
    parts = f"{here.doing}{share}", sample, f"{left:.0f} s left" if left >= 1.0 else ""
    return ", ".join(part for part in parts if part)


def _seconds_left(here: Progress, done: float, total: int, elapsed: float) -> float:
    """Predicted seconds left after `elapsed` seconds; 0 (unknown) before the first time sample is done."""
    finished = (done + here.done / max(here.total, 1)) / total
    return elapsed * (1.0 - finished) / finished if finished > 0.0 else 0.0


def _is_shown(total: int, quiet: bool) -> bool:
    return not quiet and sys.stderr is not None and sys.stderr.isatty() and total > 0


def _is_in_lines() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and context.meta.get(FORM) == "json"


@contextmanager
def _lines(total: int, what: str, here: Progress | None) -> Iterator[Callable[..., object]]:
    """Print a line of JSON at the beginning, after items (at most one per LINES_S), and at the end; if `here` is given,
    also one every WITHIN_S.
    """
    done, printed, last, begun = 0, -1, 0.0, time.monotonic()
    lock, ended = threading.Lock(), threading.Event()

    def print_line(**within: object) -> None:
        nonlocal printed
        with lock:
            printed = done
            click.echo(json.dumps({"progress": what, "done": done, "total": total, **within}), err=True)

    def print_position() -> None:
        while here is not None and not ended.wait(WITHIN_S):  # ends at once without a position
            values: dict[str, object] = {"step": here.doing, "share": round(here.share, 3)}
            values |= {"sample": min(here.done + 1, here.total), "samples": here.total}
            if left := _seconds_left(here, done, total, time.monotonic() - begun):
                values["seconds_left"] = round(left, 1)
            print_line(**values)

    def advance(count: int = 1) -> None:
        nonlocal done, last
        done += count
        if (now := time.monotonic()) > last + LINES_S:
            last = now
            print_line()

    print_line()
    thread = threading.Thread(target=print_position, daemon=True)
    thread.start()
    try:
        yield advance
    finally:
        ended.set()
        thread.join()
        if printed != done:
            print_line()


@contextmanager
def shares(quiet: bool) -> Iterator[Callable[[float], object]]:
    """Show a bar like `progress`, for work that reports a fraction from 0 to 1."""
    shown = 0
    with progress(100, quiet, "percent") as advance:

        def show_share(share: float) -> None:
            nonlocal shown
            if (percent := int(100 * share)) > shown:
                advance(percent - shown)
                shown = percent

        yield show_share
