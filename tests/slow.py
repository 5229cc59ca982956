"""Sets of parameters of which few are looked at by `make test`, and the others by `make test-slow`."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import product
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], kept: Collection[Any]) -> list[Any]:
    """Parameters: all values, those that are not kept marked as slow; tuples are several parameters of a test."""
    found = list(values)
    assert all(value in found for value in kept)
    return [
        pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=[pytest.mark.slow] * (value not in kept))
        for value in found
    ]


def combined(*values: Iterable[Any], kept: Collection[tuple[Any, ...]]) -> list[Any]:
    """The same of all combinations of several parameters."""
    return mostly_slow(product(*values), kept)
