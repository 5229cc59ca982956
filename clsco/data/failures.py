"""Failures while a set is made: failures of a sample, and failures of the machine."""

from __future__ import annotations

import errno
from collections.abc import Iterator

from clsco.errors import ClscoError, KernelError, MissingDependencyError

_ERRNOS_OF_MACHINE = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EROFS,
}  # fmt: skip


def failure_of(error: BaseException, where: str) -> tuple[str, str]:
    """Class and text of an error while a shard is made; "fatal" if other shards would also fail, else "failed"."""
    is_fatal = is_of_machine(error) or any(isinstance(cause, OSError) for cause in _causes(error))
    text = f"{where}: the disk must work, and memory must suffice" if is_fatal else "sample: must be made"
    got = (isinstance(error, OSError) and error.strerror) or repr(error)
    return "fatal" if is_fatal else "failed", str(error) if isinstance(error, ClscoError) else f"{text}; got {got}"


def is_of_machine(error: BaseException) -> bool:
    """True if the machine, not a sample, caused an error: it is out of space, memory or file handles, its disk fails, a
    kernel does not build, or a package is missing. Such an error ends the run, and the set is resumed later.
    """
    return any(
        isinstance(cause, KernelError | MissingDependencyError | MemoryError)
        or (isinstance(cause, OSError) and cause.errno in _ERRNOS_OF_MACHINE)
        for cause in _causes(error)
    )


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__
