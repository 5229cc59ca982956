"""A click group that turns errors into messages and exit statuses."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from clsco.cli.output import echo, visible_usage
from clsco.errors import ClscoError, DeviceError, SceneError

USER_ERROR, NO_DEVICE = 1, 3
ENDINGS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""Last line that a command prints after each signal; its exit status is 128 plus the signal's number."""


@contextmanager
def _end_by_signals() -> Iterator[list[int]]:
    """Make the signals of `ENDINGS` raise KeyboardInterrupt in the block, so that no file is left half-written; yields
    a list of those that arrive, because an import may replace KeyboardInterrupt by another error.
    """
    arrived = list[int]()
    if threading.current_thread() is not threading.main_thread():
        yield arrived
        return

    def end(number: int, _: object) -> NoReturn:
        arrived.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, end) for number in ENDINGS}
    try:
        yield arrived
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Commands(click.Group):
    """A group whose commands report an error in one line and exit with its status."""

    def make_context(self, *args: Any, **options: Any) -> click.Context:
        """Parse a command line."""
        with visible_usage():
            return super().make_context(*args, **options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; user errors and the signals of `ENDINGS` end it with one line."""
        with _end_by_signals() as signals:
            try:
                with visible_usage():
                    return super().invoke(ctx)
            except BaseException as error:
                ending = _ending(error, signals)
                if ending is None:
                    raise
            lines, status = ending
            for line in lines:
                echo(line, err=True)
            raise click.exceptions.Exit(status)


def _ending(error: BaseException, signals: Sequence[int]) -> tuple[list[str], int] | None:
    """Lines and exit status for errors of the user or the machine, and signals; None for others, and a closed pipe."""
    if signals or isinstance(error, KeyboardInterrupt):
        number = signal.Signals(signals[0]) if signals else signal.SIGINT
        return [ENDINGS[number]], 128 + number
    if isinstance(error, MemoryError):
        return ["error: memory: must hold the arrays of the scene; got too little of it"], USER_ERROR
    if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
        return [f"error: {error.filename or 'output'}: must be writable; got {error.strerror}"], USER_ERROR
    if isinstance(error, ClscoError):
        messages = error.messages if isinstance(error, SceneError) else (str(error),)
        status = NO_DEVICE if isinstance(error, DeviceError) else USER_ERROR
        return [f"error: {message}" for message in messages], status
    return None
