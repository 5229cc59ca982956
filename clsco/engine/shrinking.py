"""Runs work in strips that fit the memory, and retries with smaller strips if the device has less than it reports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Generic, TypeVar

from clsco.errors import DeviceError
from clsco.opencl.session import Session
from clsco.plan.memory import Limit

F = TypeVar("F")  # description of work that fits a limit: plans, or the height of strips
T = TypeVar("T")


class Shrinking(Generic[F]):
    """Runs work that fits a memory limit; if the device runs short of memory, retries with half of the memory.

    fit: returns the description of the work that fits a limit, such as a plan; size: returns the bytes of its buffers.
    """

    def __init__(
        self, session: Session, limit: Limit, fit: Callable[[Limit], F], size: Callable[[F], int]
    ) -> None:  # fmt: skip
        self.session, self.limit, self.fit, self.size = session, limit, fit, size
        self.fitting = fit(limit)

    def run(self, work: Callable[[F], T]) -> T:
        """Call `work` with the description that fits, and return its result. Raises DeviceError if even the smallest
        work does not fit, or for any other error of the device.
        """
        while True:
            try:
                with self.session.reporting():
                    return work(self.fitting)
            except DeviceError as error:
                total = min(self.limit.total, self.size(self.fitting)) // 2
                self.limit = replace(self.limit, total=total, set_by_user=False)
                before, self.fitting = self.fitting, self.fit(self.limit)
                if not error.short_of_memory or self.fitting == before:
                    raise
