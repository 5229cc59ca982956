"""Cache of computed values by key, limited in bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

V = TypeVar("V")


class _Key:
    """A key whose hash is computed once: hashing a scene or a plan walks through all of its values."""

    __slots__ = ("hashed", "value")

    def __init__(self, value: Hashable) -> None:
        self.value, self.hashed = value, hash(value)

    def __hash__(self) -> int:
        return self.hashed

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.hashed == other.hashed and self.value == other.value


class Cache:
    """Values by key, up to `limit` bytes in all; evicts the least recently used. Threads may share a cache."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._lock = threading.Lock()
        self._values: OrderedDict[_Key, tuple[Any, int]] = OrderedDict()
        self.bytes = 0  # size of all cached values

    def get(self, key: Hashable, make: Callable[[], V], size: Callable[[V], int]) -> V:
        """Return the value of a key, which callers must not change; if it is not cached, `make` computes it.

        size: returns the size of a value in bytes; a value larger than the limit is returned without being cached. If
        threads compute the same value at the same time, all of them get the one that was cached first.
        """
        place = _Key(key)
        with self._lock:
            if place in self._values:
                self._values.move_to_end(place)
                return self._values[place][0]
        value = make()
        needed = size(value)
        with self._lock:
            if place in self._values:
                return self._values[place][0]
            if needed <= self.limit:
                self._values[place] = value, needed
                self.bytes += needed
                while self.bytes > self.limit:
                    self.bytes -= self._values.popitem(last=False)[1][1]
        return value

    def forget(self, key: Hashable) -> None:
        """Remove the value of a key, if it is cached."""
        with self._lock:
            self.bytes -= self._values.pop(_Key(key), (None, 0))[1]

    def clear(self) -> None:
        """Remove all values."""
        with self._lock:
            self._values.clear()
            self.bytes = 0
