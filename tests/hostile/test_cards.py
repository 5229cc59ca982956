"""Every value of a card and of manifest lines, changed: commands report each of them in lines, never by a traceback."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import clsco.data
from clsco.data import pool
from clsco.data.manifest import part_key
from tests.cli.test_dataset import DISTRIBUTION, HerePool
from tests.command import clsco_
from tests.hostile.test_sets import read_json, write_json

LONG = "w" * 5000
GONE = object()
CHANGES: tuple[Any, ...] = (
    GONE, None, True, 7, -1, 2.5, 1e400, 10**30, "", LONG, "/dev/zero", "../x", "\x1b[2J", "\ud800", [], [1], [[1, 2]],
    [LONG] * 3, {}, {"a": 1}, {LONG: LONG}, {"shape": [LONG]},
)  # fmt: skip
COMMANDS = ("open --sheet a.png", "status", "show 0", "verify --sample 2", "convert -o spare --format npz", "remake")


def places(node: Any, location: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Locations of all values in nested tables and lists, and of those themselves."""
    yield location
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from places(value, (*location, key))


def lines_of(path: Path) -> list[str]:
    return read_json(path).splitlines() if path.suffix == ".jsonl" else [read_json(path)]


def change(path: Path, number: int, location: tuple[Any, ...], value: Any) -> None:
    """Change or remove a value in a line of a file; the first line of a part agrees with the others."""
    lines = lines_of(path)
    node = root = [json.loads(lines[number])]
    for key in (0, *location)[:-1]:
        node = node[key]
    node[(0, *location)[-1]] = value
    if value is GONE:
        del node[(0, *location)[-1]]
    lines[number] = json.dumps(root[0] if root else {})
    if number:
        body = "".join(f"{line}\n" for line in lines[1:]).encode()
        lines[0] = json.dumps(json.loads(lines[0]) | {"rows": hashlib.sha256(body).hexdigest()})
    write_json(path, "".join(f"{line}\n" for line in lines))


def fault_of(command: str) -> str:
    """Fault in the outcome of a command on the changed set, or ""."""
    shutil.rmtree("spare", ignore_errors=True)
    name, *options = command.split()
    result = clsco_("dataset", name, "set", *options)
    reports = not result.exit_code and name in ("open", "show")  # what the set holds
    lines = (result.stderr if reports else result.output).splitlines()
    if result.exit_code not in (0, 1) or not isinstance(result.exception, SystemExit | None):
        return f"{command}: {result.exit_code} {result.exception!r:.200}"
    if "w" * 201 in "".join(lines) or max(map(len, lines), default=0) > 600:
        return f"{command}: {max(lines, key=len):.200}, a long line"
    is_clear = not result.exit_code or all("; got " in line for line in result.stderr.splitlines())
    return "" if is_clear else f"{command}: {result.stderr:.200}"


@pytest.mark.parametrize("count", [40, pytest.param(10**9, marks=pytest.mark.soak)])
def test_changed_values_are_reported(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pool, "_Pool", HerePool)
    Path("set.toml").write_text(DISTRIBUTION)
    options: Any = {"types": "color=float32", "splits": "train=60,test=40", "format": "npz+raw"}
    clsco.data.make("set.toml", "whole", count=3, shard_size=2, **options)
    monkeypatch.setattr("clsco.data.creation.run_pool", lambda *_: None)
    cases = [
        (name, number, location, value)
        for name in ("dataset.json", part_key(0), str(next(Path("whole").glob("*/*/*0.npz")).relative_to("whole")))
        for number, line in enumerate(lines_of(Path("whole", name)))
        for location in places(json.loads(line))
        for value in CHANGES
    ]
    faults = []
    for name, *about in random.Random(1).sample(cases, min(count, len(cases))):
        shutil.rmtree("set", ignore_errors=True)
        shutil.copytree("whole", "set")
        change(Path("set", name), *about)
        faults += [f"{name} {about!r:.120}: {fault}" for command in COMMANDS if (fault := fault_of(command))]
    assert faults == []
