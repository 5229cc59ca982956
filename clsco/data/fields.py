"""Types of the entries of JSON files in data sets, which are untrusted."""

from __future__ import annotations

from types import UnionType
from typing import Any

from clsco.files.strict_json import strict_json
from clsco.scene.text import key_name, shown

NUMBER = range(2**40)  # numbers of samples and shards, sizes in bytes
ARRAY = {"dtype": str, "shape": [NUMBER], "unit": str, "convention": str, "transfer?": str}
_NAMES: dict[Any, str] = {str: "text", dict: "table", list: "list", float | int: "number", dict | None: "table or null"}


def checked_json(content: bytes, kind: Any) -> Any:
    """Parse JSON. Raises ValueError, with a short text, for invalid JSON and for entries of another kind."""
    value = strict_json(content)
    if fault := misfit(value, kind):
        raise ValueError(fault)
    return value


def misfit(value: Any, kind: Any, *location: str | int) -> str:
    """The first entry that is not of its kind, such as `seed "1", which is no number from 0 to 9`; "" if there is none.

    kind: a type; a range of integers; [kind] for a list, (kind, kind) for a list of two; {"a": kind, "b?": kind} for a
    table that must have `a` and may have `b`; {str: kind} for a table with any keys.
    """
    inner: list[tuple[str | int, Any, Any]] = []
    if isinstance(kind, dict) and isinstance(value, dict):
        if str in kind:
            inner = [(name, each, kind[str]) for name, each in value.items()]
        for key, own in kind.items() if str not in kind else ():
            name = key.removesuffix("?")
            if name == key or name in value:
                inner.append((name, value.get(name, ...), own))
    elif isinstance(value, list) and (isinstance(kind, list) or (isinstance(kind, tuple) and len(value) == len(kind))):
        kinds = kind if isinstance(kind, tuple) else kind * len(value)
        inner = [(place, each, own) for place, (each, own) in enumerate(zip(value, kinds, strict=True))]
    elif not (type(value) is int and value in kind if isinstance(kind, range) else _is_a(value, kind)):
        named = key_name(location) if location else "content"
        return f"no {named}" if value is ... else f"{named} {shown(value)}, which is no {_name(kind)}"
    return next(filter(None, (misfit(each, own, *location, name) for name, each, own in inner)), "")


def _is_a(value: Any, kind: Any) -> bool:
    return isinstance(kind, type | UnionType) and isinstance(value, kind)


def _name(kind: Any) -> str:
    if isinstance(kind, range):
        return f"number from {kind.start} to {kind.stop - 1}"
    if isinstance(kind, tuple):
        return f"list of {len(kind)}"
    return _NAMES[kind if isinstance(kind, type | UnionType) else type(kind)]
