"""How far work has come, as a bar on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(total: int, quiet: bool, what: str = "frames") -> Iterator[Callable[[], object]]:
    """Show a bar on a terminal, nothing in a pipe; gives what is to be called after each frame, or what it is."""
    if quiet or sys.stderr is None or not sys.stderr.isatty() or not total:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def shares(quiet: bool) -> Iterator[Callable[[float], object]]:
    """A bar as of `progress` for work that reports the share that is done, from 0 to 1."""
    shown = 0
    with progress(100, quiet, "percent") as advance:

        def reached(share: float) -> None:
            nonlocal shown
            while shown < int(100 * share):
                advance()
                shown += 1

        yield reached
