"""Text for the terminal, which may come from files of strangers: what a terminal would obey is shown as its escape."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from clsco.errors import visible


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print text to stdout or stderr.

    Parameters
    ----------
    text : str
        Lines.
    err : bool
        To stderr.
    nl : bool
        End with the end of a line.
    """
    click.echo(visible(text, lines=True), err=err, nl=nl)


@contextmanager
def visible_usage() -> Iterator[None]:
    """Errors of usage from inside have no characters that a terminal obeys: arguments may be names of files."""
    try:
        yield
    except click.UsageError as error:
        vars(error)["message"] = visible(error.message, lines=True)
        raise
