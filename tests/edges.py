"""Memory around the buffers of kernels, which no kernel may write: for tests on a processor."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

from clsco.opencl import buffers
from tests.conftest import tested_device

EDGE = 4096  # bytes before and behind a buffer
WRITTEN, MARK = cl.mem_flags.READ_WRITE, 0xA5


class Edges:
    """Makes buffers in the middle of blocks of host memory, whose ends hold a mark."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []

    def buffer(self, context: cl.Context, flags: int, size: int = 0, hostbuf: Any = None) -> cl.Buffer:
        """`pyopencl.Buffer`; one that kernels write without contents of its own has edges."""
        if not flags & WRITTEN or flags & cl.mem_flags.COPY_HOST_PTR:
            return cl.Buffer(context, flags, size, hostbuf)
        size = size or hostbuf.nbytes
        self.blocks.append(block := np.full(size + 2 * EDGE + EDGE, MARK, np.uint8))
        start = EDGE - block.ctypes.data % EDGE
        self.blocks[-1] = block[start : start + size + 2 * EDGE]
        return cl.Buffer(context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=self.blocks[-1][EDGE : EDGE + size])

    def written(self) -> list[tuple[int, int]]:
        """Size of each buffer with a written edge, and the first written place, bytes from its start."""
        overwritten = []
        for block in self.blocks:
            places = np.flatnonzero(np.r_[block[:EDGE], block[-EDGE:]] != MARK)
            if places.size:
                size, first = block.size - 2 * EDGE, int(places[0])
                overwritten.append((size, first - EDGE if first < EDGE else first - EDGE + size))
        return overwritten


@pytest.fixture(autouse=True)
def edges(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test whose kernels write beyond the ends of a buffer."""
    if not tested_device().unified_memory:
        yield
        return
    made = Edges()
    monkeypatch.setattr(buffers, "cl", SimpleNamespace(**vars(cl) | {"Buffer": made.buffer}))
    yield
    assert made.written() == []
