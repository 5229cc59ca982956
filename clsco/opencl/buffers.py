"""Buffers on the device, and transfer of arrays to the device and back."""

from __future__ import annotations

import sys
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import DTypeLike, NDArray

from clsco.errors import DeviceError
from clsco.opencl.device import failure
from clsco.opencl.pages import LARGE, SMALLEST, shared_pages
from clsco.opencl.session import Session


def upload(session: Session, array: NDArray[Any], lent: bool = False) -> cl.Buffer:
    """A read-only buffer with the contents of `array`, in C order.

    If the device uses host memory and the array is C-ordered, and aligned or `lent` for a short time, the buffer uses
    the array's memory and keeps it alive: until the last kernel that reads it has ended, the caller must neither write
    to the array nor drop the buffer. Raises DeviceError if the array is larger than the device allows for one buffer,
    or memory is short.
    """
    packed = np.ascontiguousarray(array)
    if packed.nbytes == 0:
        return empty(session, 0)
    in_place = session.device.unified_memory and (lent or packed.ctypes.data % session.device.alignment == 0)
    flags = cl.mem_flags.USE_HOST_PTR if in_place else cl.mem_flags.COPY_HOST_PTR
    with _allocating(session, packed.nbytes):
        return cl.Buffer(session.context, cl.mem_flags.READ_ONLY | flags, hostbuf=packed)


def upload_cached(session: Session, array: NDArray[Any], place: Hashable) -> cl.Buffer:
    """`upload` of an array that never changes, cached in the session; replaces an earlier array of this `place`."""
    key = ("array", place)
    for _ in range(2):
        buffer, owner = session.cache.get(key, lambda: (upload(session, array), array), lambda pair: pair[1].nbytes)
        if owner is array:
            return buffer
        session.queue.finish()  # kernels may still read the previous array in place
        session.cache.forget(key)
    return upload(session, array)  # another thread uses another array with the same key


def copied(session: Session, array: NDArray[Any]) -> cl.Buffer:
    """A read-write buffer with a copy of `array` in C order. Raises the errors of `upload`."""
    packed = np.ascontiguousarray(array)
    if not 0 < packed.nbytes < LARGE:
        buffer = empty(session, packed.nbytes)
        if packed.nbytes:
            cl.enqueue_copy(session.queue, buffer, packed)
        return buffer
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR  # faster than a command in the queue
    with _allocating(session, packed.nbytes):
        return cl.Buffer(session.context, flags, hostbuf=packed)


def empty(session: Session, size: int) -> cl.Buffer:
    """An uninitialized read-write buffer of `size` bytes. Raises DeviceError as `upload`."""
    flags = cl.mem_flags.READ_WRITE
    with _allocating(session, size):
        if session.device.unified_memory and size >= SMALLEST and sys.platform == "linux":
            return cl.Buffer(session.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=shared_pages().take(size))
        return cl.Buffer(session.context, flags, max(size, 1))  # OpenCL has no empty buffers


class Refilled:
    """A buffer that the host refills; a new copy is enqueued after the launches that read the previous one."""

    def __init__(self, session: Session, size: int) -> None:
        self.session, self.buffer = session, empty(session, size)
        self._copy: cl.Event | None = None

    def fill(self, array: NDArray[Any]) -> cl.Buffer:
        """Enqueue a copy of an array, which must not change until the copy ends; waits for the previous copy."""
        queue, packed = self.session.queue, np.ascontiguousarray(array)
        # pyopencl waits for a copy before it frees the event of the copy.
        self._copy = cl.enqueue_copy(queue, self.buffer, packed, is_blocking=False) if packed.nbytes else None
        return self.buffer


def allocate(session: Session, sizes: Mapping[str, int]) -> dict[str, cl.Buffer]:
    """Uninitialized buffers by name; sizes: sizes in bytes by name. Raises DeviceError as `upload`."""
    return {name: empty(session, size) for name, size in sizes.items()}


def filled_with(session: Session, size: int, value: float = 0.0) -> cl.Buffer:
    """A buffer of `size` bytes, filled with the float `value`."""
    buffer = empty(session, size)
    cl.enqueue_fill_buffer(session.queue, buffer, np.array([value], np.float32), 0, size)
    return buffer


def download(session: Session, buffer: cl.Buffer, shape: Sequence[int], dtype: DTypeLike) -> NDArray[Any]:
    """Wait for all enqueued commands, and copy the buffer's beginning to a new array. May raise DeviceError."""
    array = np.empty(tuple(shape), dtype)
    download_into(session, buffer, array)
    return array


def download_into(session: Session, buffer: cl.Buffer, array: NDArray[Any]) -> None:
    """Wait for all enqueued commands, and copy the buffer's beginning to a C-ordered array. Raises as `download`."""
    if array.nbytes:
        with _reporting(session, "give results back"):
            cl.enqueue_copy(session.queue, array, buffer, is_blocking=True)


@contextmanager
def mapped(session: Session, buffer: cl.Buffer, shape: Sequence[int]) -> Iterator[NDArray[np.float32]]:
    """Map a buffer's beginning as an array in the block, without a copy on processors. Waits for all commands."""
    args = cl.map_flags.READ, 0, tuple(shape), np.dtype(np.float32)
    with _reporting(session, "give results back"):
        array, _ = cl.enqueue_map_buffer(session.queue, buffer, *args, is_blocking=True)
    try:
        yield array
    finally:
        array.base.release(session.queue)


@contextmanager
def _reporting(session: Session, task: str) -> Iterator[None]:
    """Convert errors in the block, which does `task`, to DeviceError."""
    try:
        yield
    except (cl.Error, OSError) as error:
        raise failure(session.device, task, error) from error


def _allocating(session: Session, size: int) -> AbstractContextManager[None]:
    """Check the size of a buffer, and convert errors of its allocation in the block to DeviceError."""
    if size > (most := session.device.max_alloc):
        raise DeviceError(f"device {session.device}: a buffer must be at most {most} bytes; got {size}")
    return _reporting(session, f"have memory for a buffer of {size} bytes")
