"""The command `clsco`.

Exit status: 0 done; 1 a user's error, one line on stderr; 2 wrong usage; 3 no device; 130 interrupted; 143 terminated.
"""

from __future__ import annotations

import errno
import signal
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NoReturn

import click

from clsco import __version__
from clsco.cli.output import echo, visible_usage
from clsco.errors import ClscoError, DeviceError, SceneError

COMMANDS = {
    "check": ("scenes", "Compare frames with the NumPy reference."),
    "dataset": ("dataset", "Make data sets of many scenes drawn from distributions."),
    "defocus": ("images", "Defocus IMAGE by its depth map DEPTH."),
    "demo": ("scenes", "Render some of the example scenes."),
    "devices": ("devices", "List OpenCL devices, what each can do, and which one is used."),
    "examples": ("examples", "List the example files, or copy some."),
    "inpaint": ("images", "Fill the missing pixels of IMAGE."),
    "plan": ("scenes", "Report what rendering a scene takes, and how long."),
    "psf": ("psf", "Write the point spread functions of a scene's lens."),
    "render": ("render", "Render the frames of scenes to files."),
    "schema": ("scenes", "Print the JSON Schema of a scene file."),
    "studio": ("studio", "Edit a scene in the browser while it is rendered."),
    "validate": ("scenes", "Check scene files and their textures without rendering."),
    "video": ("video", "Make a clip of the frames in DIR, which clsco render wrote."),
}
"""Module of each command, imported when the command is called, and the command's line in the list of commands."""


USER_ERROR, NO_DEVICE = 1, 3
ENDINGS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""Last line that a command prints after each signal; its exit status is 128 plus the signal's number."""


@contextmanager
def _end_by_signals() -> Iterator[list[int]]:
    """Make the signals of `ENDINGS` raise KeyboardInterrupt in the block, so that no file is left half-written.

    Yields a list to which arriving signals are added, because an import may replace KeyboardInterrupt by another error.
    """
    arrived = list[int]()
    if threading.current_thread() is not threading.main_thread():
        yield arrived
        return

    def end(number: int, _: object) -> NoReturn:
        arrived.append(number)
        warnings.simplefilter("ignore")  # libraries warn of coroutines that are dropped unawaited
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
    """Lines to print and exit status for a signal, or an error of the user or the machine; None for other errors."""
    if signals or isinstance(error, KeyboardInterrupt):
        number = signal.Signals(signals[0]) if signals else signal.SIGINT
        return [ENDINGS[number]], 128 + number
    if isinstance(error, MemoryError):
        return ["error: memory: must hold the arrays of the scene; got too little of it"], USER_ERROR
    if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
        opens = error.errno in (errno.EMFILE, errno.ENFILE)
        rule = "ulimit -n: must allow more open files" if opens else f"{error.filename or 'output'}: must be writable"
        return [f"error: {rule}; got {error.strerror}"], USER_ERROR
    if isinstance(error, ClscoError):
        messages = error.messages if isinstance(error, SceneError) else (str(error),)
        status = NO_DEVICE if isinstance(error, DeviceError) else USER_ERROR
        return [f"error: {message}" for message in messages], status
    return None


class _LazyCommands(Commands):
    """A group with the commands in `COMMANDS`, whose modules are imported when they are needed."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, without importing their modules."""
        stubs: dict[str, click.Command] = {name: click.Command(name, help=text) for name, (_, text) in COMMANDS.items()}
        click.Group(commands=stubs).format_commands(ctx, formatter)

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> Any:
        del ctx
        if name not in COMMANDS:
            return None
        return getattr(import_module(f"clsco.cli.{COMMANDS[name][0]}"), name)


@click.group(cls=_LazyCommands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clsco")
@click.option("-v", "--verbose", count=True, help="Say on stderr what is done; -vv: with all details.")
def main(verbose: int) -> None:
    """Images of moving objects out of focus, with their ground truth."""
    if verbose:
        from clsco.cli.output import show_log

        show_log(verbose)
