"""Allowed outcomes of hostile input: a scene or messages of one line that name a key, soon, and nothing written."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from clsco.errors import ClscoError, FileError, SceneError

LONGEST_S, LONGEST_WAIT_S = 5.0, 30.0  # of the processor's time, and of time in which others may have the processor
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = {f"os.{name}" for name in ("mkdir", "rename", "remove", "rmdir", "symlink", "link", "truncate", "chmod")}
# Of a file as a whole, without a key: `where: rule`.
OF_THE_FILE = re.compile(
    r"must be UTF-8 text; got byte 0x[0-9a-f]{2}|nested too deeply|not valid (TOML|JSON): .+|cannot be read: .+"
    r"|a (line|scene file) must .+|must be a (table|file); got .+|and \d+ more faults|.+: key given twice",
    re.DOTALL,
)
# A bare key, one in quotes, or a position, as often as there are; several keys of a sweep are listed.
PART = r"(?:[A-Za-z0-9_-]{1,64}|\"(?:[^\"\\]|\\.)*\"|\[-?\d+\])"
KEY = re.compile(rf"({PART}(?:\.?{PART})*(?:, {PART}(?:\.?{PART})*)*(?: and \d+ more)?): (.+); got (.+)", re.DOTALL)
OF_AN_IMAGE = re.compile(r".+; got .+")
MOST_CHARACTERS = 2000

_watching: list[str] | None = None


class TooLongError(Exception):
    """A case has taken longer than it may."""


def _seen(event: str, args: tuple[Any, ...]) -> None:
    if _watching is None:
        return
    is_file = not isinstance(args[0], int) and args[0] != os.devnull  # a process gets its streams so
    if event in CHANGES or (event == "open" and is_file and isinstance(args[2], int) and args[2] & WRITING):
        _watching.append(f"{event} {args[0]!r}")


def start_watching() -> None:
    """Have all that the process writes found from now on, and cases that hang interrupted."""
    sys.addaudithook(_seen)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"more than {LONGEST_S:g} s")

    signal.signal(signal.SIGPROF, interrupt)
    signal.signal(signal.SIGALRM, interrupt)


@contextmanager
def watched() -> Iterator[list[str]]:
    """A list of what is written in the block, which is interrupted when it takes too long."""
    global _watching
    written: list[str] = []
    _watching = written
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_WAIT_S)
    try:
        yield written
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        _watching = None


def faults_of(error: ClscoError, where: str) -> list[str]:
    """Faults in the messages of an error, which has to name `where`, a key, a rule and a value."""
    messages = error.messages if isinstance(error, SceneError) else (str(error),)
    found = [] if messages else ["no message"]
    for message in messages:
        if not message.isprintable():
            found.append(f"more than one line, or control characters: {ascii(message)[:300]}")
        if len(message) > MOST_CHARACTERS:
            found.append(f"{len(message)} characters: {ascii(message)[:300]}")
        rest = message.removeprefix(f"{where}: ")
        form = OF_AN_IMAGE if isinstance(error, FileError) else KEY
        if rest == message or not (form.fullmatch(rest) or OF_THE_FILE.fullmatch(rest)):
            found.append(f"no `where: key: rule; got value`: {ascii(message)[:300]}")
    return found


def keys_of(error: SceneError, where: str) -> list[str]:
    """The keys that the messages name."""
    found = (KEY.fullmatch(message.removeprefix(f"{where}: ")) for message in error.messages)
    return [match[1] for match in found if match]
