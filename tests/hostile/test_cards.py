"""Every value of a card and of manifest lines, changed: commands report each of them in lines, never by a traceback."""

from __future__ import annotations

import copy
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

LONG = "w" * 5000
GONE = object()
CHANGES: tuple[Any, ...] = (
    GONE, None, True, 7, -1, 2.5, 1e400, 10**30, "", LONG, "/dev/zero", "../x", "\x1b[2J", "\ud800", [], [1], [[1, 2]],
    [LONG] * 3, {}, {"a": 1}, {LONG: LONG}, {"shape": [LONG]},
)  # fmt: skip
COMMANDS = ("open", "status", "show 1", "verify --sample 2", "convert -o spare --format npz", "remake")
REPORTS = ("open", "show 1")  # print what a set holds


def places(node: Any, location: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Locations of all values in nested tables and lists, and of those themselves."""
    yield location
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from places(value, (*location, key))


def changed(node: Any, location: tuple[Any, ...], value: Any) -> Any:
    """A copy of nested tables and lists with another value, or without it."""
    if not location:
        return value if value is not GONE else {}
    root = node = copy.deepcopy(node)
    for key in location[:-1]:
        node = node[key]
    if value is GONE:
        del node[location[-1]]
    else:
        node[location[-1]] = value
    return root


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set that was really made, of three samples."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "set.toml").write_text(DISTRIBUTION)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "_Pool", HerePool)
        options: Any = {"types": "color=float32", "splits": "train=60,test=40", "format": "npz+raw"}
        clsco.data.make(folder / "set.toml", folder / "set", count=3, shard_size=2, **options)
    return folder / "set"


def cases(whole: Path) -> list[tuple[str, int, tuple[Any, ...], Any]]:
    """File, line in it, location in that line and new value of each change."""
    lines = {
        "dataset.json": [(whole / "dataset.json").read_text()],
        part_key(0): (whole / part_key(0)).read_text().splitlines(),
    }
    return [
        (name, number, location, value)
        for name, texts in lines.items()
        for number, text in enumerate(texts)
        for location in places(json.loads(text))
        for value in CHANGES
    ]


def write_change(folder: Path, name: str, number: int, location: tuple[Any, ...], value: Any) -> None:
    """Change a value in a file of a set; the first line of a part agrees with the others."""
    path = folder / name
    lines = path.read_text().splitlines() if name != "dataset.json" else [path.read_text()]
    lines[number] = json.dumps(changed(json.loads(lines[number]), location, value))
    if number:
        body = "".join(f"{line}\n" for line in lines[1:]).encode()
        lines[0] = json.dumps(json.loads(lines[0]) | {"rows": hashlib.sha256(body).hexdigest()})
    path.write_text("".join(f"{line}\n" for line in lines))


def faults_of(command: str) -> list[str]:
    """What is wrong with the outcome of a command on the changed set."""
    shutil.rmtree("spare", ignore_errors=True)
    words = command.split()
    result = clsco_(
        "dataset", words[0], "set", *words[1:], *["--quiet"] * (words[0] in ("verify", "convert", "remake"))
    )
    wrong = []
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return [f"{command}: {result.exception!r:.200}"]
    text = result.stderr + ("" if command in REPORTS and not result.exit_code else result.stdout)
    if result.exit_code not in (0, 1):
        wrong.append(f"{command}: exit status {result.exit_code} {text:.200}")
    if "w" * 201 in text or max(map(len, text.splitlines()), default=0) > 600:
        wrong.append(f"{command}: a long line {max(text.splitlines(), key=len):.150}")
    if result.exit_code == 1 and not all("; got " in line for line in result.stderr.splitlines()):
        wrong.append(f"{command}: no rule and value: {result.stderr:.200}")
    return wrong


@pytest.mark.parametrize("count", [40, pytest.param(10**9, marks=pytest.mark.soak)])
def test_changed_values_are_reported(count: int, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clsco.data.creation.run_pool", lambda *_: None)
    listed = cases(whole)
    found = []
    for case in random.Random(1).sample(listed, min(count, len(listed))):
        shutil.rmtree("set", ignore_errors=True)
        shutil.copytree(whole, "set")
        write_change(Path("set"), *case)
        found += [f"{case!r:.150}: {fault}" for command in COMMANDS for fault in faults_of(command)]
    assert found == []
