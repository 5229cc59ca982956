"""Pool of host memory for buffers on a processor: renderings reuse pages, because the system clears new ones slowly."""

from __future__ import annotations

import ctypes
import mmap
import sys
import threading
import weakref
from collections import OrderedDict, deque
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMALLEST = 2**16  # least size in bytes of an array with its own pages
LARGE = 2**22  # size in bytes from which on a block always contains a whole page of 2 MiB
SPARE_BYTES = 2**27  # memory limit of unused blocks
SLACK = 4  # a block is reused for a request if it exceeds the request by at most 1 / SLACK of that
CLASSES = 8  # sizes of blocks per octave: a block is at most 1 / CLASSES larger than the request


class Pages:
    """Pool of memory blocks; a block returns to the pool when its array is freed. Threads may share a pool.

    limit: limit of unused blocks, bytes; beyond it, those that are unused for the longest time return to the system.
    """

    def __init__(self, limit: int = SPARE_BYTES) -> None:
        self.limit = limit
        self._lock = threading.Lock()
        self._back: deque[mmap.mmap] = deque()  # blocks returned by finalizers, which may run while the lock is held
        self._free: OrderedDict[int, mmap.mmap] = OrderedDict()
        self.bytes = 0  # size of the unused blocks

    def take(self, size: int) -> NDArray[np.uint8]:
        """Uninitialized array of `size` bytes; its memory returns to the pool when it is freed. Raises OSError."""
        bytes_ = block_size(size)
        with self._lock:
            self._take_back()
            free = ((len(block), key) for key, block in self._free.items())
            free_bytes, key = min((e for e in free if bytes_ <= e[0] <= bytes_ + bytes_ // SLACK), default=(0, 0))
            block = self._free.pop(key, None)
            self.bytes -= free_bytes
        if block is None:
            block = _cleared(bytes_)
        array = np.frombuffer(block, np.uint8)
        weakref.finalize(array, self._give, block).atexit = False
        return array[:size]

    def _give(self, block: mmap.mmap) -> None:
        self._back.append(block)
        if self._lock.acquire(blocking=False):
            try:
                self._take_back()
            finally:
                self._lock.release()

    def _take_back(self) -> None:
        while self._back:
            block = self._back.popleft()
            self._free[id(block)] = block
            self.bytes += len(block)
            while self.bytes > self.limit:
                self.bytes -= len(self._free.popitem(last=False)[1])

    def clear(self) -> None:
        """Return all unused blocks to the system."""
        with self._lock:
            self._take_back()
            self._free.clear()
            self.bytes = 0


def joined_in_pages(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Arrays concatenated along their first axis in C order, in pages of their own. Devices that use host memory read
    them in place, and the pages return to the system when the result is freed.
    """
    shape = (sum(len(array) for array in arrays), *arrays[0].shape[1:])
    size = sum(array.nbytes for array in arrays)
    if size == 0:
        return np.empty(shape, arrays[0].dtype)
    out: NDArray[Any] = np.frombuffer(_cleared(size), arrays[0].dtype).reshape(shape)
    return np.concatenate(arrays, out=out)


def is_in_pages(array: NDArray[Any]) -> bool:
    """True if an array begins at the start of a page, as arrays from `joined_in_pages` do."""
    return array.ctypes.data % mmap.PAGESIZE == 0


def trim() -> None:
    """Make the C library return its free memory to the system, if it can."""
    with suppress(AttributeError, OSError, TypeError):  # not the GNU C library, or Windows
        ctypes.CDLL(None).malloc_trim(0)


def _cleared(size: int) -> mmap.mmap:
    """New memory of `size` bytes from the system; from LARGE on, in pages of 2 MiB if the system has these."""
    if sys.platform != "linux":
        return mmap.mmap(-1, size)
    block = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if size >= LARGE:
        with suppress(OSError):
            block.madvise(mmap.MADV_HUGEPAGE)
    return block


def block_size(size: int) -> int:
    """Size of the block for a request of `size` bytes: whole pages, and one of CLASSES sizes per octave."""
    step = max(1 << max(size.bit_length() - 1, 0), mmap.PAGESIZE * CLASSES) // CLASSES
    return -(-size // step) * step


@cache
def shared_pages() -> Pages:
    """The pool that all sessions of this process share."""
    return Pages()
