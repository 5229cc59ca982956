"""A click group that turns errors into messages and exit statuses."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from clsco.cli.output import echo, visible_usage
from clsco.errors import ClscoError, DeviceError, SceneError

USER_ERROR, NO_DEVICE, INTERRUPTED, TERMINATED = 1, 3, 130, 143


class _TerminatedError(KeyboardInterrupt):
    """SIGTERM arrived; it ends a command as Ctrl-C does."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Make SIGTERM end the block as Ctrl-C does, so that no file is left half-written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> NoReturn:
        raise _TerminatedError

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Commands(click.Group):
    """A group whose commands report an error in one line and exit with its status."""

    def make_context(self, *args: Any, **options: Any) -> click.Context:
        """Parse a command line."""
        with visible_usage():
            return super().make_context(*args, **options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; user errors, Ctrl-C and SIGTERM end it without a traceback."""
        try:
            with visible_usage(), _terminable():
                return super().invoke(ctx)
        except _TerminatedError:
            echo("terminated", err=True)
            ctx.exit(TERMINATED)
        except KeyboardInterrupt:
            echo("interrupted", err=True)
            ctx.exit(INTERRUPTED)
        except MemoryError:
            echo("error: memory: must hold the arrays of the scene; got too little of it", err=True)
            ctx.exit(USER_ERROR)
        except BrokenPipeError:
            raise  # who reads the output has had enough, which click takes for an end
        except OSError as error:
            echo(f"error: {error.filename or 'output'}: must be writable; got {error.strerror}", err=True)
            ctx.exit(USER_ERROR)
        except ClscoError as error:
            for message in error.messages if isinstance(error, SceneError) else (str(error),):
                echo(f"error: {message}", err=True)
            ctx.exit(NO_DEVICE if isinstance(error, DeviceError) else USER_ERROR)
