"""Sessions: a context and a queue on a device, with the programs built in the context."""

from __future__ import annotations

import os
import threading
from collections.abc import Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from shutil import which
from types import TracebackType
from typing import Self, TypeAlias

import pyopencl as cl

from clsco.cache import Cache
from clsco.errors import CanceledError, DeviceError
from clsco.opencl import pocl_cache as poclcache
from clsco.opencl import pocl_cpu as poclcpu
from clsco.opencl.device import Device, check_not_forked, choose, describe_device, failure
from clsco.opencl.pace import Pace

CACHE_BYTES = 2**28
_TIMED = cl.command_queue_properties.PROFILING_ENABLE

DeviceLike: TypeAlias = str | cl.Device | cl.Context | cl.CommandQueue | None
"""A user's argument `device`: a part of a name, "cpu", "gpu", an object of pyopencl, or None for the default."""

Kernels: TypeAlias = dict[str, cl.Kernel]
"""Kernels of a built program by name, because to look up a kernel in OpenCL takes 0.2 ms."""


@dataclass
class Progress:
    """Progress of a rendering, readable by another thread.

    doing: kind of a pass, or "compiling" and names of files or of a kernel; share: finished fraction of the latest
    launch; done: number of finished time samples, counted for each strip; total: number of them in the whole frame.
    """

    doing: str = ""
    share: float = 0.0
    done: int = 0
    total: int = 0


class Session:
    """A context and an in-order queue with profiling on one device, and the programs built in the context.

    queue, context: used by the session; by default it opens new ones. If the queue is out of order or has no profiling,
    the session opens another one in the context of the queue. Threads may share a session. No session works after a
    fork, where PoCL would hang: it raises DeviceError, so start processes by spawning. Raises DeviceError if the device
    refuses a context.
    """

    def __init__(self, device: Device, queue: cl.CommandQueue | None = None, context: cl.Context | None = None) -> None:
        check_not_forked()
        self.device = device
        self.lock = threading.RLock()
        self.cache = Cache(CACHE_BYTES)  # buffers that are filled once, by keys that describe their content
        self.canceled = threading.Event()  # set this to cancel the session's work at the next call of `go_on`
        # Progress for another thread to read. If it is set, the host is at most one time sample ahead of the device.
        self.progress: Progress | None = None
        # `programs`: by their text and the compiler's options. `requests`: by the arguments of `program.build`.
        self.programs: dict[Hashable, Kernels] = {}
        self.requests: dict[Hashable, Kernels] = {}
        # Names of kernels with their features, of which few are not used; kernels and launch shapes that are compiled.
        self.offered: set[Hashable] = set()
        self.compiled: set[tuple[cl.Kernel, tuple[int, ...], bool, bool]] = set()
        self.pace = Pace()
        if device.is_pocl:
            poclcache.prepare()  # the user may have opened a queue before clsco listed devices
            poclcache.check()
            poclcpu.ensure_known(device.handle)
        try:
            if queue is not None:
                context = queue.context
            self.context = cl.Context([device.handle]) if context is None else context
            if queue is None or not _is_usable(queue):
                queue = cl.CommandQueue(self.context, device.handle, properties=_TIMED)
            self._queue = queue
        except cl.Error as error:
            raise failure(device, "open a context and a queue", error) from error

    def with_cache(self, limit: int) -> Session:
        """A session with the same queue and programs, but with its own progress and its own cache of `limit` bytes."""
        session = copy(self)
        session.cache, session.canceled, session.progress = Cache(limit), threading.Event(), Progress()
        return session

    def unwatched(self) -> Session:
        """A copy of this session that records no progress, for background work."""
        session = copy(self)
        session.progress = None
        return session

    def doing(self, step: str) -> None:
        """Record in `progress`, if it is set, that `step` is being done."""
        if self.progress is not None:
            self.progress.doing, self.progress.share = step, 0.0

    def go_on(self) -> None:
        """Raise CanceledError if `canceled` is set."""
        if self.canceled.is_set():
            raise CanceledError("render: must go on to be done; got a call of cancel")

    @property
    def queue(self) -> cl.CommandQueue:
        """The queue. Raises DeviceError in a fork of the process that opened it."""
        check_not_forked()
        return self._queue

    def compiling(self) -> AbstractContextManager[None]:
        """Context manager for a block in which the driver may compile: no other process then writes to PoCL's cache.

        Raises DeviceError if PoCL would abort the process, as on a full disk or without a linker.
        """
        if not self.device.is_pocl:
            return nullcontext()
        folder, where, got = os.environ.get(poclcache.VARIABLE, "none"), f"device {self.device}", ""
        if not poclcache.is_on_disk():
            where, rule, got = poclcache.VARIABLE, "must be a folder on a disk, for kernels", folder
        elif got := poclcache.shortage():
            rule = f"kernels need {poclcache.ROOM >> 20} MiB in the folder {folder}, and {poclcache.HANDLES} open files"
        elif "PoCL 3." in self.device.platform_version and which("ld") is None:
            rule = "kernels are linked by ld, which must be in a folder of PATH; Debian and Ubuntu have it in binutils"
            got = "no such program"
        if got:
            raise DeviceError(f"{where}: {rule}; got {got}") from OSError(got)  # so that it ends the making of a set
        return poclcache.exclusive()

    def close(self) -> None:
        """Wait for the queue and release the programs; the context is released with its last buffer."""
        with self.lock:
            self.queue.finish()
            self.cache.clear()
            self.compiled.clear()
            self.pace.clear()
            self.offered.clear()
            self.programs.clear()
            self.requests.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            with self.reporting():
                self.close()
            return
        with suppress(cl.Error, DeviceError):  # the first error is raised
            self.close()
        if isinstance(error, cl.Error):
            raise failure(self.device, "go on", error) from error

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """Convert errors of OpenCL in the block to DeviceError; an error is raised when all commands have ended.

        After an error other than a lack of memory the context may be lost, so `session_on` will open another one.
        """
        try:
            yield
        except BaseException as error:
            self.settle()
            raised = failure(self.device, "go on", error) if isinstance(error, cl.Error) else error
            if isinstance(raised, DeviceError) and not raised.short_of_memory:
                session_on.cache_clear()
            if raised is not error:
                raise raised from error
            raise

    def settle(self) -> None:
        """Wait until all enqueued commands have ended, and ignore their errors."""
        with suppress(cl.Error, DeviceError):
            self.queue.finish()


# Contexts and built programs are cached, because creating them takes longer than a small image, and because PoCL leaks
# the memory of released programs (2 MiB each).
@lru_cache(maxsize=8)
def session_on(place: Device | cl.CommandQueue | cl.Context) -> Session:
    """A session on a device, in a queue, or in a context, on its first device; the last eight sessions are cached."""
    if isinstance(place, cl.CommandQueue):
        return Session(describe_device(place.device), queue=place)
    if isinstance(place, cl.Context):
        return Session(describe_device(place.devices[0]), context=place)
    return Session(place)


def session_for(device: DeviceLike) -> Session:
    """The session for a user's argument `device`. Raises DeviceError."""
    if device is None or isinstance(device, str):
        return session_on(choose(device))
    if isinstance(device, cl.CommandQueue | cl.Context):
        return session_on(device)
    if isinstance(device, cl.Device):
        return session_on(describe_device(device))
    rule = "must be a part of a name, or a Device, Context or CommandQueue of pyopencl"
    raise DeviceError(f"device: {rule}; got {type(device).__name__}")


def _is_usable(queue: cl.CommandQueue) -> bool:
    timed, unordered = _TIMED, cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
    return bool(queue.properties & timed) and not queue.properties & unordered
