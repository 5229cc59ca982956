"""Data sets: samples drawn from distributions, the formats that hold them, and the loader.

`clsco.data.make(distribution, "DATA", count=100)` makes a set from a distribution file, its content or a function.
`clsco.data.open("DATA", "train")` opens one: a `Dataset` supports length, index, slices and iteration, and its items
are `Record`s.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco.data.copies import remake as remake
    from clsco.data.creation import FailedSamplesError as FailedSamplesError
    from clsco.data.creation import make as make
    from clsco.data.dataset import Dataset as Dataset
    from clsco.data.dataset import open as open  # noqa: A004
    from clsco.data.record import Record as Record

_MODULES = {
    "make": "creation", "FailedSamplesError": "creation", "open": "dataset", "Dataset": "dataset", "Record": "record",
    "remake": "copies",
}  # fmt: skip
__all__ = ["Dataset", "FailedSamplesError", "Record", "make", "open", "remake"]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"clsco.data.{_MODULES[name]}"), name)
    raise AttributeError(f"module clsco.data has no attribute {name}")
