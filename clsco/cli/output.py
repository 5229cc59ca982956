"""Text for the terminal that may come from untrusted files: control characters are shown as escapes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from clsco.errors import visible


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print text to stdout, or to stderr with `err`; nl: end the line."""
    click.echo(visible(text, lines=True), err=err, nl=nl)


def show_log(verbose: int) -> None:
    """Print messages of the logger "clsco" to stderr; verbose: 0 for warnings, 1 for progress, 2 for all details."""
    import logging

    class Stderr(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            echo(f"clsco: {record.getMessage()}", err=True)

    logger = logging.getLogger("clsco")
    logger.handlers, logger.propagate = [Stderr()], False
    logger.setLevel(logging.INFO if verbose == 1 else logging.DEBUG)


@contextmanager
def visible_usage() -> Iterator[None]:
    """Escape control characters in usage errors, because arguments may be names of untrusted files."""
    try:
        yield
    except click.UsageError as error:
        vars(error)["message"] = visible(error.message, lines=True)
        raise
