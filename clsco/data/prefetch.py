"""Prefetch a generator's items in a thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator
from typing import TypeVar

V = TypeVar("V")
DEPTH = 2


def prefetch(produced: Generator[V, None, None], depth: int = DEPTH) -> Generator[V, None, None]:
    """Yield what `produced` does, up to `depth` values of which wait meanwhile.

    An error of the producer is raised here. When this generator is closed, the producer ends before its next value.
    """
    values: queue.Queue[tuple[bool, V | BaseException | None]] = queue.Queue(depth)
    ended = threading.Event()

    def put(value: tuple[bool, V | BaseException | None]) -> None:
        while not ended.is_set():
            try:
                values.put(value, timeout=0.1)
            except queue.Full:
                continue
            return

    def produce() -> None:
        try:
            for value in produced:
                put((True, value))
                if ended.is_set():
                    return
            put((False, None))
        except BaseException as error:  # raised again where the values are used
            put((False, error))

    thread = threading.Thread(target=produce, daemon=True)
    thread.start()
    try:
        while True:
            goes_on, value = values.get()
            if isinstance(value, BaseException):
                raise value
            if not goes_on:
                return
            yield value  # type: ignore[misc]
    finally:
        ended.set()
        thread.join()
