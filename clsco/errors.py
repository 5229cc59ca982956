"""Errors that clsco raises on purpose: what the user can mend, reported in one line each."""

from __future__ import annotations

from collections.abc import Sequence


class ClscoError(Exception):
    """Something the user can mend; the message says `where: rule; got value`, on one line."""

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


class SceneError(ClscoError):
    """A scene is not valid; `messages` holds one line per fault, all faults of the scene at once."""

    def __init__(self, messages: str | Sequence[str]) -> None:
        self.messages = tuple(map(_one_line, (messages,) if isinstance(messages, str) else messages))
        Exception.__init__(self, "\n".join(self.messages))

    def __reduce__(self) -> tuple[type[SceneError], tuple[tuple[str, ...]]]:
        return type(self), (self.messages,)  # from process to process


class ImageError(ClscoError):
    """An image or ground-truth file cannot be read or written."""


class DeviceError(ClscoError):
    """No usable OpenCL device, or the device cannot do what was asked; `short_of_memory`: it might with less memory."""

    def __init__(self, message: str, short_of_memory: bool = False) -> None:
        self.short_of_memory = short_of_memory
        super().__init__(message)


class CanceledError(ClscoError):
    """A render was canceled before it was done (`clsco.Live.cancel`)."""


class KernelError(ClscoError):
    """A kernel does not build; the message holds the compiler's log with file names."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)


def _one_line(message: str) -> str:
    """The message with escapes in place of control characters, which names of files and values may have."""
    if message.isprintable():
        return message
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
