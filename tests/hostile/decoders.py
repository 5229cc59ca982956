"""Decoders for a process of their own: a module that imports little, as each new process does so."""

from __future__ import annotations

import os
from typing import Any

import numpy as np


def ended(file: Any) -> None:
    """A decoder that crashes."""
    os.abort()


def slow(file: Any) -> None:
    """A decoder that goes on for ever."""
    while True:
        pass


def hungry(file: Any) -> tuple[dict[str, Any], list[Any]]:
    """A decoder that takes 1 GiB."""
    return {"bytes": len(bytes(2**30))}, []


def generous(file: Any) -> tuple[dict[str, Any], list[Any]]:
    """A decoder that gives more than it was asked for."""
    return {}, [np.zeros(2**20)]


def echo(file: Any, **options: Any) -> tuple[dict[str, Any], list[Any]]:
    """A decoder that says what it read."""
    return {"content": file.read().decode(), **options}, [np.arange(6, dtype=">i4").reshape(2, 3), np.zeros((0, 2))]
