"""Arrays that stay on the device: once each, and one in each place."""

from __future__ import annotations

import threading

import numpy as np
import pyopencl as cl

from clsco.opencl.buffers import download, empty, upload_cached
from clsco.opencl.session import Session


def test_an_array_takes_the_place_of_an_earlier_one(session: Session) -> None:
    own = session.with_cache(2**20)
    first, second = np.arange(1000, dtype=np.float32), np.arange(2000, dtype=np.float32)
    other = first + 1.0
    buffers = [upload_cached(own, first, "table"), upload_cached(own, other, "another")]
    assert upload_cached(own, first, "table") is buffers[0]
    assert own.cache.bytes == 2 * first.nbytes
    buffers.append(upload_cached(own, second, "table"))
    assert own.cache.bytes == second.nbytes + other.nbytes
    for buffer, array in zip(buffers, (first, other, second), strict=True):  # those in use stay what they are
        np.testing.assert_array_equal(download(own, buffer, array.shape, np.float32), array)
    assert upload_cached(own, first, "table") is not buffers[0]
    assert upload_cached(own, other, "another") is buffers[1]


def test_an_array_stays_until_commands_have_read_it(session: Session) -> None:
    own, begins = session.with_cache(2**20), cl.UserEvent(session.context)
    first, second = np.arange(1000, dtype=np.float32), np.arange(2000, dtype=np.float32)
    out, buffer = empty(own, first.nbytes), upload_cached(own, first, "table")
    copied = cl.enqueue_copy(own.queue, out, buffer, wait_for=[begins])
    go_on = threading.Timer(0.2, begins.set_status, [cl.command_execution_status.COMPLETE])
    go_on.start()
    upload_cached(own, second, "table")
    assert copied.command_execution_status == cl.command_execution_status.COMPLETE
    go_on.join()
