"""Cache of values that are made once, by their keys and within a limit of bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

V = TypeVar("V")


class _Key:
    """A key that is hashed once: hashes of scenes and plans go through all that is in them."""

    __slots__ = ("hashed", "value")

    def __init__(self, value: Hashable) -> None:
        self.value, self.hashed = value, hash(value)

    def __hash__(self) -> int:
        return self.hashed

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.hashed == other.hashed and self.value == other.value


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
        self._values: OrderedDict[_Key, tuple[Any, int]] = OrderedDict()
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
        place = _Key(key)
        with self._lock:
            if place in self._values:
                self._values.move_to_end(place)
                found: V = self._values[place][0]
                return found
        value = make()
        needed = size(value)
        with self._lock:
            if place in self._values:
                earlier: V = self._values[place][0]
                return earlier
            if needed <= self.limit:
                self._values[place] = value, needed
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
            self._bytes -= self._values.pop(_Key(key), (None, 0))[1]

    def clear(self) -> None:
        """Let go of all values."""
        with self._lock:
            self._values.clear()
            self._bytes = 0
