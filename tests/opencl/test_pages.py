"""Memory of buffers on processors: used again when a buffer is gone, and never more than a limit unused."""

from __future__ import annotations

import gc
import mmap

import numpy as np
import pytest

from clsco.opencl.buffers import download, empty, filled_with
from clsco.opencl.pages import CLASSES, SMALLEST, Pages, block_size, shared_pages
from clsco.opencl.session import Session


def test_sizes_are_few_and_close() -> None:
    sizes = range(SMALLEST, 2**22, 4099)
    blocks = {block_size(size) for size in sizes}
    assert len(blocks) <= 7 * CLASSES
    for size in sizes:
        assert size <= block_size(size) <= max(size * (1 + 1 / CLASSES), size + mmap.PAGESIZE)
        assert block_size(size) % mmap.PAGESIZE == 0


def test_a_block_comes_back_when_its_array_is_gone() -> None:
    pages = Pages()
    array = pages.take(100_000)
    array[:] = 7
    part = array[10:20]
    del array
    assert pages.bytes == 0  # a part of it is in use
    del part
    assert pages.bytes == block_size(100_000)
    again = pages.take(99_000)
    assert pages.bytes == 0
    assert len(again) == 99_000
    assert (again == 7).all()  # the same memory, which is not initialized


def test_what_nobody_uses_is_limited() -> None:
    pages = Pages(limit=3 * block_size(SMALLEST))
    arrays = [pages.take(SMALLEST) for _ in range(5)]
    arrays.clear()
    assert pages.bytes == 3 * block_size(SMALLEST)
    pages.clear()
    assert pages.bytes == 0


def test_buffers_use_blocks_again(session: Session) -> None:
    if not session.device.unified_memory:
        pytest.skip("buffers of this device are not in the host's memory")
    gc.collect()
    shared_pages().clear()
    buffer = filled_with(session, 2**20, 3.0)
    assert (download(session, buffer, (2**18,), np.float32) == 3.0).all()
    before = shared_pages().bytes
    del buffer
    assert shared_pages().bytes - before == block_size(2**20)
    buffer = empty(session, 2**20 - 100)
    assert shared_pages().bytes == before
    assert buffer.size == 2**20 - 100


def test_a_block_that_comes_back_amid_a_search_waits_for_its_end() -> None:
    pages = Pages()
    array = pages.take(SMALLEST)
    address = array.ctypes.data
    with pages._lock:  # as in `take`, where the garbage collector may run
        del array
        assert not pages._free
    assert pages.take(SMALLEST).ctypes.data == address
