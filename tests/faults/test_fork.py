"""A fork of a process that has used OpenCL: reported at once, where PoCL would wait for ever."""

from __future__ import annotations

import os
import pickle
import time
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import clsco
from clsco.errors import DeviceError, SceneError
from clsco.opencl.buffers import download, empty
from clsco.opencl.device import choose
from clsco.opencl.session import Session

IMAGE = np.ones((8, 8), np.float32)


@pytest.mark.parametrize("what", ["choose", "session", "defocus", "old session"])
def test_a_fork_is_reported(session: Session, what: str) -> None:
    calls: dict[str, Callable[[], object]] = {
        "choose": lambda: choose("pocl"),
        "session": lambda: Session(session.device),
        "defocus": lambda: clsco.defocus(IMAGE, IMAGE),
        "old session": lambda: download(session, empty(session, 8), (2,), np.float32),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of threads, which Python has seen
        child = os.fork()
    if child == 0:
        try:
            calls[what]()
        except DeviceError as error:
            os._exit(7 if "started by spawning; got a fork of process" in str(error) else 8)
        except BaseException:
            os._exit(9)
        os._exit(0)
    end = time.monotonic() + 20
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < end:
        time.sleep(0.01)
    if ended[0] == 0:
        os.kill(child, 9)
        os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(ended[1]) == 7


def test_errors_go_from_process_to_process() -> None:
    error = pickle.loads(pickle.dumps(SceneError(["a: b; got c", "d: e; got f"])))
    assert error.messages == ("a: b; got c", "d: e; got f")
    assert str(error) == "a: b; got c\nd: e; got f"
    assert pickle.loads(pickle.dumps(DeviceError("x", short_of_memory=True))).short_of_memory
