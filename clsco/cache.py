"""Cache of values that are made once, by their keys and within a limit of bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

V = TypeVar("V")


class Cache:
    """A table of values within a limit of bytes: the least recently used ones go. Safe to share between threads.

    Parameters
    ----------
    limit : int
        Most bytes of all values; a larger value is not kept.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._lock = threading.Lock()
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._bytes = 0

    def get(self, key: Hashable, make: Callable[[], V], size: Callable[[V], int]) -> V:
        """The value of a key.

        Parameters
        ----------
        key : hashable
        make : callable
            Makes the value, where it is not there; two threads may do so at the same time, and get one value.
        size : callable
            Bytes of a value.

        Returns
        -------
        The value, which nobody may change.
        """
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                found: V = self._values[key][0]
                return found
        value = make()
        needed = size(value)
        with self._lock:
            if key in self._values:
                earlier: V = self._values[key][0]
                return earlier
            if needed <= self.limit:
                self._values[key] = value, needed
                self._bytes += needed
                while self._bytes > self.limit:
                    self._bytes -= self._values.popitem(last=False)[1][1]
        return value

    @property
    def bytes(self) -> int:
        """Size of all values that are kept."""
        return self._bytes

    def forget(self, key: Hashable) -> None:
        """Let go of the value of a key, where there is one."""
        with self._lock:
            self._bytes -= self._values.pop(key, (None, 0))[1]

    def clear(self) -> None:
        """Let go of all values."""
        with self._lock:
            self._values.clear()
            self._bytes = 0
