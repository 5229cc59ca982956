"""Values are kept within a limit: the least recently used go, and a value that is too large is not kept."""

from __future__ import annotations

import threading
from typing import NamedTuple

from clsco.cache import Cache


def test_the_least_recently_used_goes() -> None:
    cache, made = Cache(10), list[str]()

    def get(key: str, size: int = 4) -> str:
        return cache.get(key, lambda: made.append(key) or key, lambda _: size)  # type: ignore[func-returns-value]

    assert [get("a"), get("b"), get("a"), get("c"), get("a")] == ["a", "b", "a", "c", "a"]
    assert (made, cache.bytes) == (["a", "b", "c"], 8)
    get("b")
    assert made == ["a", "b", "c", "b"]  # c was used before a
    get("c")
    assert made[-1] == "c"
    get("large", 11)
    get("large", 11)
    assert made[-2:] == ["large", "large"]
    assert cache.bytes == 8
    cache.clear()
    assert cache.bytes == 0


def test_threads_get_one_value() -> None:
    cache, barrier, found = Cache(100), threading.Barrier(4), list[object]()

    def run() -> None:
        def make() -> object:
            barrier.wait()
            return object()

        found.append(cache.get("key", make, lambda _: 1))

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert len(set(map(id, found))) == 1
    assert cache.bytes == 1


def test_what_is_forgotten_is_made_again() -> None:
    cache, made = Cache(10), list[int]()

    def get() -> int:
        return cache.get("key", lambda: made.append(1) or len(made), lambda _: 4)  # type: ignore[func-returns-value]

    assert (get(), get(), cache.bytes) == (1, 1, 4)
    cache.forget("key")
    cache.forget("key")
    assert (cache.bytes, get()) == (0, 2)


def test_keys_are_hashed_once_a_request() -> None:
    hashed = list[int]()

    class Key(NamedTuple):
        number: int

        def __hash__(self) -> int:
            hashed.append(self.number)
            return 5  # as that of any other

    cache = Cache(10)
    found = [cache.get(Key(number), lambda number=number: number, lambda _: 4) for number in (1, 2, 1)]  # type: ignore[misc]
    assert (found, hashed) == ([1, 2, 1], [1, 2, 1])
