"""Host memory of buffers on a processor, from render to render: what the system has to clear once is used again."""

from __future__ import annotations

import mmap
import threading
import weakref
from collections import OrderedDict
from contextlib import suppress
from functools import cache

import numpy as np
from numpy.typing import NDArray

SMALLEST = 2**16  # bytes, of what is worth keeping
LARGE = 2**22  # bytes, from which a block holds at least one page of 2 MiB
KEPT_BYTES = 2**27  # of blocks that nobody uses
CLASSES = 8  # sizes of blocks per octave: a block is at most 1 / CLASSES larger than what is asked for


class Pages:
    """Blocks of memory that come back when the arrays in them are gone. Safe to share between threads.

    Parameters
    ----------
    limit : int
        Most bytes of blocks that nobody uses; those given back longest ago go to the system.
    """

    def __init__(self, limit: int = KEPT_BYTES) -> None:
        self.limit = limit
        self._lock = threading.RLock()  # a finalizer may run in the thread that holds it
        self._free: OrderedDict[int, mmap.mmap] = OrderedDict()
        self._bytes = 0

    def take(self, size: int) -> NDArray[np.uint8]:
        """Bytes that are not initialized, in pages of 2 MiB where the system has them; back when the array is gone.

        Raises OSError where there is no memory.
        """
        wanted = block_size(size)
        with self._lock:
            key = next((key for key, block in self._free.items() if len(block) == wanted), None)
            block = None if key is None else self._free.pop(key)
            self._bytes -= 0 if block is None else wanted
        if block is None:
            block = mmap.mmap(-1, wanted, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
            if wanted >= LARGE:
                with suppress(OSError):
                    block.madvise(mmap.MADV_HUGEPAGE)
        array = np.frombuffer(block, np.uint8)
        weakref.finalize(array, self._give, block).atexit = False
        return array[:size]

    def _give(self, block: mmap.mmap) -> None:
        with self._lock:
            self._free[id(block)] = block
            self._bytes += len(block)
            while self._bytes > self.limit:
                self._bytes -= len(self._free.popitem(last=False)[1])

    @property
    def bytes(self) -> int:
        """Of blocks that nobody uses."""
        return self._bytes

    def clear(self) -> None:
        """Give all blocks that nobody uses back to the system."""
        with self._lock:
            self._free.clear()
            self._bytes = 0


def block_size(size: int) -> int:
    """Bytes of the block for so many: whole pages, and one of CLASSES sizes per octave."""
    step = max(1 << max(size.bit_length() - 1, 0), mmap.PAGESIZE * CLASSES) // CLASSES
    return -(-size // step) * step


@cache
def shared_pages() -> Pages:
    """The blocks of all sessions of this process."""
    return Pages()
