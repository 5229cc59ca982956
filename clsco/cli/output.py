"""Text for the terminal, which may come from files of strangers: what a terminal would obey is shown as its escape."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from clsco.errors import visible


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print text to stdout, or to stderr; nl: end with the end of a line."""
    click.echo(visible(text, lines=True), err=err, nl=nl)


def show_log(verbose: int) -> None:
    """Print messages of the logger "clsco" to stderr, of other levels than warnings as well: 1 for what is done, 2 for
    all details."""
    import logging

    class Stderr(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            echo(f"clsco: {record.getMessage()}", err=True)

    logger = logging.getLogger("clsco")
    logger.handlers, logger.propagate = [Stderr()], False
    logger.setLevel(logging.INFO if verbose == 1 else logging.DEBUG)


@contextmanager
def visible_usage() -> Iterator[None]:
    """Errors of usage from inside have no characters that a terminal obeys: arguments may be names of files."""
    try:
        yield
    except click.UsageError as error:
        vars(error)["message"] = visible(error.message, lines=True)
        raise
