"""Broken scene files: valid examples with a few changes, by a seed and a number, the same ones on every run."""

from __future__ import annotations

import copy
import datetime
import json
import math
import random
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests.hostile.pictures import Change, cut, flip

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NUMBERS: tuple[Any, ...] = (
    0, -0.0, 1, -1, 2, 3.5, 1e-320, 5e-324, 1e-9, 1e-6, 1e-3, 90.0, 1e3, 1e6, 1e9, -1e9, 1e30, 1e39, 1e154, 1e300,
    1e308, -1e308, math.nan, math.inf, -math.inf, 2**31, 2**53 + 1, 2**63, -(2**63), 2**64, 10**80, -(10**80), 10**400,
    65536, 4096,
)  # fmt: skip
WORDS: tuple[str, ...] = (
    "", " ", "x", "auto", "bricks", "visibility", "layered", "forward", "inverse", "gaussian", "plane", "sphere",
    "depth_map", "disparity", "disc", "box", "background", "surface", "triplanar", "cube", "mirror", "cart", "#c86432",
    "1", "nan", "true", "\0", "\n", "\x1b[31m", "\x7f", "\u202e", "\ufeff", "\uffff", "\U0010ffff", "é" * 3000,
    "a" * 100_000, "../../../etc/passwd", "/dev/zero", "/dev/stdin", ".", "..", "frame_0000.png", "%s%n{}{0}",
    "a/" * 3000, "'; drop", "\\", '"', "con.png", "//", "~", "$HOME",
)  # fmt: skip
ODD: tuple[Any, ...] = (
    True, False, [], {}, [[]], [{}], [0, 0, 0], [1e9, -1e9, 1e9], [1, 2], [[0, 1], [0, 1], [0, 1]],
    [[1, 0], [1, 0], [1, 0]], [math.nan] * 3, [10**400] * 10, [None], [0] * 5000, ["a", 1, []],
    {"from": 1, "to": 2, "steps": 3}, {"from": 1, "to": 1, "steps": 2}, {"from": 0, "to": 1e300, "steps": 4096},
    {"from": [0, 0, 0], "to": [1, 1], "steps": 2}, {"steps": 10**400}, {"from": math.nan},
    {"axis": [0, 0, 1], "angle": 30.0}, {"axis": [0, 0, 0], "angle": 1.0}, {"quaternion": [1, 0, 0, 0]},
    {"quaternion": [0] * 4}, [{"name": "cart"}], {"direction": [0, 0, 1]}, {"position": [0, 0, 0], "ambient": 2},
    [1, 1], [1, 2, 3, 4], ["midpoint", "endpoint"], ["midpoint", 3], {"shape": "sphere"}, [{"shape": "plane"}] * 3,
    datetime.date(1979, 5, 27), datetime.time(7, 32), datetime.datetime(1979, 5, 27, tzinfo=datetime.UTC),
)  # fmt: skip
KEYS = (
    "", "x", "a b", "objects", "f_numbr", "__class__", "model_config", "a" * 5000, "\n", "\x1b[2J", "é", "0", "ä.b",
    "from",
)  # fmt: skip
TOKENS: tuple[bytes, ...] = (
    b"nan", b"-inf", b"1e999", b"1" * 80, b"9" * 5000, b"0x" + b"f" * 400, b"1_000", b"0o7", b"[" * 3000, b"{a=" * 3000,
    b"[[object]]", b"[object]", b"[camera]", b"[[camera]]", b"object = 3\n", b"camera.camera.camera = 1\n",
    b"a" + b".a" * 99 + b" = 1\n", b"a" + b".a" * 200 + b" = 1\n", 3 * b'"', b"'''", b'"', b"'", b"\\", b"\\u0000",
    b"\\uD800", b"\\U00110000", b"\0", b"\x01", b"\x1b[2J", b"\x7f", b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xef\xbb\xbf",
    b"\r", b"\r\n", b"\n", b"=", b",", b".", b"#", b"[", b"]", b"{", b"}", b"1979-05-27T07:32:00Z", b"25:00:00",
    b"0000-00-00", b"title = '" + b"a" * 100_000 + b"'\n", b"x = [" + b"1," * 10_000 + b"]\n", b"-", b"+", b"_",
    b"true", b"false", b"\xe2\x80\xae",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A changed scene: `text` of a file with that suffix, or `mapping` as it would be read from one.

    changed: the keys of the one change of a mapping, the outermost first; () where there are several changes.
    """

    base: str
    suffix: str = ".toml"
    text: bytes | None = None
    mapping: dict[str, Any] | None = None
    changed: tuple[str | int, ...] = ()


@cache
def bases() -> dict[str, tuple[bytes, dict[str, Any]]]:
    """Text and content of every example, with files that the examples read in absolute paths."""
    found = {}
    for path in sorted(path for path in EXAMPLES.rglob("*.toml") if path.parent.name != "sets"):
        text = re.sub(r'(?m)^(texture|depth) = "(\w+\.png)"', rf'\1 = "{EXAMPLES}/\2"', path.read_text("utf-8"))
        found[path.stem] = (text.encode(), tomllib.loads(text))
    return found


def make_case(seed: int, number: int) -> Case:
    """The case of this number: a text in three of ten, else a mapping."""
    rng = random.Random(f"{seed}:{number}")
    name = rng.choice(list(bases()))
    text, mapping = bases()[name]
    if rng.random() < 0.3:
        suffix = ".toml"
        if rng.random() < 0.2:
            text, suffix = json.dumps(mapping, indent=1).encode(), ".json"
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            text = rng.choice(TEXT_CHANGES)(rng, text)
        return Case(name, suffix, text=text)
    changed = copy.deepcopy(mapping)
    times = rng.choice((1, 1, 1, 2, 3))
    for _ in range(times):
        if not changed:
            break
        location = rng.choice(VALUE_CHANGES)(rng, changed)
    return Case(name, mapping=changed, changed=location if times == 1 else ())


def hostile_value(rng: random.Random) -> Any:
    """Any one value that no rule has in mind."""
    kind = rng.random()
    if kind < 0.4:
        return rng.choice(NUMBERS)
    if kind < 0.55:
        return rng.choice((1, -1)) * rng.random() * 10.0 ** rng.randint(-12, 12)
    if kind < 0.75:
        return rng.choice(WORDS)
    if kind < 0.97:
        return copy.deepcopy(rng.choice(ODD))
    deep: Any = rng.choice(NUMBERS)
    for _ in range(rng.choice((5, 100, 3000))):
        deep = [deep] if rng.random() < 0.5 else {"a": deep}
    return deep


Location = tuple[str | int, ...]


def _places(node: Any, location: Location = ()) -> list[tuple[Any, str | int, Location]]:
    """Every entry of nested mappings and lists: what holds it, its key there, and its location."""
    entries = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    found = []
    for key, value in entries:
        found.append((node, key, (*location, key)))
        if len(location) < 6:  # deeper ones are hostile values of an earlier change
            found += _places(value, (*location, key))
    return found


def _replace(rng: random.Random, mapping: dict[str, Any]) -> Location:
    holder, key, location = rng.choice(_places(mapping))
    holder[key] = hostile_value(rng)
    return location


def _nudge(rng: random.Random, mapping: dict[str, Any]) -> Location:
    """Scale a number, so that it often stays valid and meets the rules that look at several keys."""
    numbers = [place for place in _places(mapping) if type(place[0][place[1]]) in (int, float)]
    if not numbers:
        return _replace(rng, mapping)
    holder, key, location = rng.choice(numbers)
    try:
        holder[key] = type(holder[key])(holder[key] * rng.choice((-1, 0, 0.5, 1.001, 2, 10, 1e-3, 1e3, 1e6, 1e-6)))
    except (OverflowError, ValueError):  # of an earlier change
        holder[key] = 0
    return location


def _drop(rng: random.Random, mapping: dict[str, Any]) -> Location:
    holder, key, location = rng.choice(_places(mapping))
    del holder[key]
    return location


def _rename(rng: random.Random, mapping: dict[str, Any]) -> Location:
    places = [place for place in _places(mapping) if isinstance(place[1], str)]
    holder, key, location = rng.choice(places)
    new = rng.choice(KEYS) if rng.random() < 0.5 else str(key)[:-1] + rng.choice("xyz_")
    holder[new] = holder.pop(key)
    return (*location[:-1], new)


def _add(rng: random.Random, mapping: dict[str, Any]) -> Location:
    """Give a table a key of another table, or an unknown one."""
    holders: list[tuple[Any, Location]] = [(mapping, ())]
    holders += [(holder[key], location) for holder, key, location in _places(mapping) if isinstance(holder[key], dict)]
    table, location = rng.choice(holders)
    _, others = rng.choice(list(bases().values()))
    other, key, _ = rng.choice([place for place in _places(others) if isinstance(place[1], str)])
    new = rng.choice(KEYS) if rng.random() < 0.2 else key
    table[new] = hostile_value(rng) if rng.random() < 0.5 else copy.deepcopy(other[key])
    return (*location, new)


def _repeat(rng: random.Random, mapping: dict[str, Any]) -> Location:
    lists = [(holder[key], at) for holder, key, at in _places(mapping) if isinstance(holder[key], list) and holder[key]]
    if not lists:
        return _replace(rng, mapping)
    entries, location = rng.choice(lists)
    entries += rng.choices(entries, k=rng.choice((1, 2, 70)))  # no copies: an earlier change may be nested too deeply
    return location


def _splice(rng: random.Random, text: bytes) -> bytes:
    """Put a token somewhere, over some bytes or between them."""
    start = rng.randrange(len(text) + 1)
    return text[:start] + rng.choice(TOKENS) + text[start + rng.choice((0, 0, 1, 5, 40)) :]


def _new_value(rng: random.Random, text: bytes) -> bytes:
    lines = text.split(b"\n")
    places = [i for i, line in enumerate(lines) if b"=" in line]
    if places:
        chosen = rng.choice(places)
        lines[chosen] = lines[chosen].split(b"=")[0] + b"= " + rng.choice(TOKENS)
    return b"\n".join(lines)


def _flip(rng: random.Random, text: bytes) -> bytes:
    return flip(rng, text, (1, 3, 20))


def _lines(rng: random.Random, text: bytes) -> bytes:
    """Give a line twice, leave one out, or put it elsewhere."""
    lines = text.split(b"\n")
    chosen = rng.choice(lines)
    if rng.random() < 0.6:
        lines.remove(chosen)
    for _ in range(rng.choice((0, 1, 2))):
        lines.insert(rng.randrange(len(lines) + 1), chosen)
    return b"\n".join(lines)


def _noise(rng: random.Random, text: bytes) -> bytes:
    start = rng.randrange(len(text) + 1)
    return text[:start] + rng.randbytes(rng.choice((1, 4, 64))) + text[start:]


TEXT_CHANGES: tuple[Change, ...] = (_splice, _new_value, _flip, cut, _lines, _noise)
VALUE_CHANGES: tuple[Callable[[random.Random, dict[str, Any]], Location], ...] = (
    _replace, _replace, _replace, _nudge, _nudge, _drop, _rename, _add, _repeat,
)  # fmt: skip
