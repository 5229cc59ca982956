"""Tables of arrays in TOML as blocks of text, with the comments above them, that are put into another order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import takewhile

_HEADER = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_-]+)")


def arranged(text: str, key: str, order: Sequence[int | None], new: Sequence[str]) -> str:
    """The text with another order of the tables of an array, each with its sub-tables and the comments above it.

    Parameters
    ----------
    text : str
        Valid TOML.
    key : str
        Key of the array: "object" for [[object]].
    order : sequence of int or None
        For each table its number in the text, counted from 0; None for a new one.
    new : sequence of str
        Text of a new table, for each place in `order`.

    Returns
    -------
    str
        Tables that others stand between come together in place of the last one. Headers inside of strings are not
        looked for: whoever needs the same content compares it.
    """
    parts = _parts(text.splitlines(), key)
    slots = [number for number, (is_table, _) in enumerate(parts) if is_table]
    if not slots or (list(order) == list(range(len(slots))) and slots[-1] - slots[0] == len(slots) - 1):
        return text
    old = [_trimmed(parts[slot][1]) for slot in slots]
    between = max(1, len(parts[slots[0]][1]) - len(old[0]))  # blank lines
    found: list[str] = []
    for number, (is_table, lines) in enumerate(parts):
        if not is_table:
            found += lines
        elif number == slots[-1]:
            for place, table in enumerate(order):
                found += new[place].strip("\n").splitlines() if table is None else old[table]
                found += [""] * between
    return "\n".join(_trimmed(found)) + "\n"


def _parts(lines: Sequence[str], key: str) -> list[tuple[bool, list[str]]]:
    """Lines of the text in parts: tables of the array, and what is between them."""
    parts: list[tuple[bool, list[str]]] = [(False, [])]
    for line in lines:
        header = _HEADER.match(line)
        if header is not None and (header[1] == "[[" or header[2] != key or not parts[-1][0]):
            begins = header[1] == "[[" and header[2] == key
            if begins or parts[-1][0]:
                before = parts[-1][1]
                above = len(list(takewhile(lambda each: each.lstrip().startswith("#"), reversed(before))))
                start = len(before) - above
                parts.append((begins, before[start:]))
                del before[start:]
        parts[-1][1].append(line)
    return parts


def _trimmed(lines: list[str]) -> list[str]:
    """Lines without the blank ones at the end."""
    end = len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    return lines[:end]
