"""OpenCL that fails: every call that pyopencl offers for buffers, builds and queues, counted, one of which raises."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pyopencl as cl
import pytest

ERRORS: dict[str, Callable[[], cl.Error]] = {
    "memory": lambda: cl.MemoryError("create_buffer failed: MEM_OBJECT_ALLOCATION_FAILURE"),
    "resources": lambda: cl.RuntimeError("clEnqueueNDRangeKernel failed: OUT_OF_RESOURCES"),
    "host memory": lambda: cl.RuntimeError("clFinish failed: OUT_OF_HOST_MEMORY"),
    "gone": lambda: cl.RuntimeError("clEnqueueNDRangeKernel failed: DEVICE_NOT_AVAILABLE"),
    "invalid": lambda: cl.LogicError("clEnqueueWriteBuffer failed: INVALID_COMMAND_QUEUE"),
}
CALLS = ("enqueue_copy", "enqueue_fill_buffer", "enqueue_map_buffer", "Buffer", "Context", "CommandQueue")


@dataclass
class Counter:
    """Calls so far, their names, and the one that raises; `after`: all that follow it raise, too."""

    fails_at: int = -1
    error: str = "memory"
    after: bool = False
    names: list[str] = field(default_factory=list)

    def call(self, name: str) -> None:
        number = len(self.names)
        self.names.append(name)
        if number == self.fails_at or (self.after and number > self.fails_at >= 0):
            raise ERRORS[self.error]()

    @property
    def has_failed(self) -> bool:
        return len(self.names) > self.fails_at >= 0


def counted(note: Callable[[str], None], name: str, function: Any) -> Any:
    """The function, whose calls are noted before."""

    def call(*args: Any, **options: Any) -> Any:
        note(name)
        return function(*args, **options)

    return call


@contextmanager
def failing(counter: Counter) -> Iterator[Counter]:
    """Count all calls in the block; the one that `counter` names raises."""
    with pytest.MonkeyPatch.context() as patch:
        for name in CALLS:
            original = getattr(cl, name)
            if isinstance(original, type):
                made = counted(counter.call, name, original.__init__)  # type: ignore[misc]
                patch.setattr(cl, name, type(name, (original,), {"__init__": made}))
            else:
                patch.setattr(cl, name, counted(counter.call, name, original))
        patch.setattr(cl.Program, "build", counted(counter.call, "build", cl.Program.build))
        patch.setattr(cl.Kernel, "__call__", counted(counter.call, "launch", cl.Kernel.__call__))
        finish = cl.CommandQueue.finish

        def finished(queue: cl.CommandQueue) -> None:
            finish(queue)  # what fails here has ended: kernels of a device that is gone read nothing any more
            counter.call("finish")

        patch.setattr(cl.CommandQueue, "finish", finished)
        yield counter
