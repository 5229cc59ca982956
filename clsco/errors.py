"""Errors that clsco raises on purpose: what the user can mend, told in one line each."""

from __future__ import annotations

from collections.abc import Sequence


class ClscoError(Exception):
    """Something the user can mend; the message says `where: rule; got value`."""


class SceneError(ClscoError):
    """A scene is not valid; `messages` holds one line per fault, all faults of the scene at once."""

    def __init__(self, messages: str | Sequence[str]) -> None:
        self.messages = (messages,) if isinstance(messages, str) else tuple(messages)
        super().__init__("\n".join(self.messages))


class ImageError(ClscoError):
    """An image or ground-truth file cannot be read or written."""


class DeviceError(ClscoError):
    """No usable OpenCL device, or the device cannot do what was asked."""


class KernelError(ClscoError):
    """A kernel does not build; the message holds the compiler's log with file names."""
