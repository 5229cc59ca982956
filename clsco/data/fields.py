"""Types of the entries of JSON files in data sets, which are untrusted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import count, repeat
from types import UnionType
from typing import Any

from clsco.errors import FileError
from clsco.files.strict_json import strict_json
from clsco.scene.text import key_name, shown

SHORT = 200  # characters of names and other texts that messages may show
NUMBER = range(2**40)  # numbers of samples and shards, sizes in bytes
ARRAY = {"dtype": str, "shape": [NUMBER], "unit": str, "convention": str, "transfer?": str}
_NAMES: dict[Any, str] = {
    str: "text", dict: "table", list: "list", tuple: "list of this length", dict | None: "table or null",
    float | int: "number", range: "number from {0.start} to below {0.stop}", int: "text of at most {} characters",
}  # fmt: skip


def checked_json(content: bytes, kind: Any, rule: str) -> Any:
    """Parse JSON. Raises FileError, which begins with `rule`, for invalid JSON, and for entries of another kind."""
    try:
        value = strict_json(content)
        fault = misfit(value, kind)
    except ValueError as error:
        fault = str(error)
    if fault:
        raise FileError(f"{rule}; got {fault}")
    return value


def misfit(value: Any, kind: Any, *location: str | int) -> str:
    """The first entry of another kind, such as `seed "1", which is no number from 0 to below 9`; "" if there is none.

    kind: a type; the largest length of a text; a range of integers; [kind] for a list, (kind, kind) for a list of two;
    {"a": kind, "b?": kind} for a table that must have `a` and may have `b`; {length: kind} for a table with any keys.
    """
    entries: Iterable[tuple[str | int, Any, Any]]
    if _is_a(value, kind):
        return ""
    if kind.__class__ is tuple and isinstance(value, list) and len(value) == len(kind):
        entries = zip(count(), value, kind, strict=False)
    elif isinstance(kind, list) and isinstance(value, list):
        entries = zip(count(), value, repeat(kind[0]), strict=False)
    elif isinstance(kind, dict) and isinstance(value, dict):
        entries = _of_table(value, kind)
    else:
        words = _NAMES[kind if isinstance(kind, type | UnionType) else type(kind)]
        named = key_name(location) if location else "content"
        return f"no {named}" if value is ... else f"{named} {shown(value)}, which is no {words.format(kind)}"
    for name, each, own in entries:
        if not _is_a(each, own) and (fault := misfit(each, own, *location, name)):
            return fault
    return ""


def _is_a(value: Any, kind: Any) -> bool:
    if kind.__class__ is range:
        return type(value) is int and value in kind
    if kind.__class__ is int:
        return isinstance(value, str) and len(value) <= kind
    return isinstance(kind, type | UnionType) and isinstance(value, kind)


def _of_table(value: Mapping[str, Any], kind: Mapping[Any, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Name, value and kind of each entry of a table; the value is ... if the table does not have it."""
    for key, own in kind.items():
        if isinstance(key, int):
            yield from ((name, name, key) for name in value)
            yield from ((name, each, own) for name, each in value.items())
        elif (name := key.removesuffix("?")) == key or name in value:
            yield name, value.get(name, ...), own
