"""The command as a process: starts fast, and exits as soon as its work is done."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from types import FrameType

_OBJECTS = 100_000
"""Number of new objects at which Python collects garbage: imports make many objects, and no garbage."""


def _end(number: int, _: FrameType | None) -> None:
    """End the process at once; a signal handler during imports, when no file can be left half-written."""
    os.write(2, b"interrupted\n" if number == signal.SIGINT else b"terminated\n")
    os._exit(128 + number)


def run() -> None:
    """Run the command line. During imports, garbage collection and pydantic's search for plug-ins are off, and at exit
    Python frees no objects: together a fifth of a short command's time (docs/lessons.md).
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # before all other imports, which take most of the time
        signal.signal(number, _end)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # escape characters that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    gc.set_threshold(_OBJECTS)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from clsco.cli.main import main

    try:
        main(prog_name="clsco")
    finally:
        gc.freeze()
