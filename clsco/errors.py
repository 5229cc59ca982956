"""Errors that clsco raises on purpose: faults that the user can correct, each reported in one line."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from unicodedata import category


class ClscoError(Exception):
    """Base of the errors for faults that a user can correct; the message is one line, `where: rule; got value`."""

    def __init__(self, message: str) -> None:
        super().__init__(visible(message))


class SceneError(ClscoError):
    """A scene is not valid; `messages` has one line for each of its faults."""

    def __init__(self, messages: str | Sequence[str]) -> None:
        self.messages = tuple(map(visible, (messages,) if isinstance(messages, str) else messages))
        Exception.__init__(self, "\n".join(self.messages))

    def __reduce__(self) -> tuple[type[SceneError], tuple[tuple[str, ...]]]:
        return type(self), (self.messages,)  # so that another process can unpickle the error


class FileError(ClscoError):
    """A file cannot be read or written, or its content cannot be used."""


class ArgumentError(ClscoError):
    """An array, or another argument of a call, is not valid."""


class MissingDependencyError(ClscoError):
    """A package that a feature needs is not installed; the message has the command that installs it."""


class DeviceError(ClscoError):
    """No OpenCL device is usable, or the device cannot do the work.

    `short_of_memory` is True if the work might succeed with less memory.
    """

    def __init__(self, message: str, short_of_memory: bool = False) -> None:
        self.short_of_memory = short_of_memory
        super().__init__(message)


class CanceledError(ClscoError):
    """`clsco.Live.cancel` ended a render."""


class KernelError(ClscoError):
    """A kernel does not build; the message has the compiler's log with file names."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)


def import_extra(where: object, module: str, extra: str) -> Any:
    """Import a module of an extra, or raise MissingDependencyError; where: file or option to name in the error."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingDependencyError(f"{where}: needs {module}: pip install 'clsco[{extra}]'; got {error}") from error


def require_extra(where: object, module: str, extra: str) -> None:
    """Raise MissingDependencyError as `import_extra` would, without importing the module."""
    if find_spec(module) is None:
        raise MissingDependencyError(f"{where}: needs {module}: pip install 'clsco[{extra}]'; got no such module")


def visible(text: str, lines: bool = False) -> str:
    r"""A text in which escapes such as \x1b replace all invisible characters except spaces.

    Names of files, and texts in them, may be untrusted: they may hold control characters, marks of writing direction
    and lone surrogates. lines: True to leave ends of lines and tabs unchanged.

    >>> from clsco.errors import visible
    >>> visible("a\x1b[2J b")
    'a\\x1b[2J b'
    """
    if text.isprintable():
        return text
    kept = "\n\t" if lines else ""

    def is_seen(c: str) -> bool:
        return c.isprintable() or c in kept or category(c) == "Zs"

    return "".join(c if is_seen(c) else c.encode("unicode_escape").decode() for c in text)
